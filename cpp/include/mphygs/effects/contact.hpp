// A plane n.x >= d that the surface may not pass, with Coulomb friction. The length of n does not matter:
// all three of its components can be fitted, with a prior for the length.
//
// Penalty: pressure stiffness * depth on the exposed area; friction mu times it against the
// tangential velocity, smoothed below a slip of 2 cm/s.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Contact {
    static constexpr EffectInfo info{"contact", "a plane n.x >= d with Coulomb friction", Site::surface, true, false, 0, 6,
                                     {{"d", "m", -1e3, -1e3, 1e3, 0.01, true},
                                      {"n_x", "-", 0, -2, 2, 1, false},
                                      {"n_y", "-", 0, -2, 2, 1, false},
                                      {"n_z", "-", 1, -2, 2, 1, false},
                                      {"mu", "-", 0, 0, 10, 0.3, true},
                                      {"stiffness", "Pa/m", 0, 0, 1e12, 1e6, false}}};
    template <class S>
    static S depth(const Vec3<S>& n, const Vec3<S>& position, const S& d) {
        return d - dot(n, position);
    }
    template <class S>
    static Vec3<S> normal(const S* q) {
        const Vec3<S> given{{q[1], q[2], q[3]}};
        return (typename ScalarOf<S>::type(1) / square_root(dot(given, given))) * given;
    }
    template <class P>
    static bool out_of_reach(const Vec3<P>& position, const P* q) {
        const P below = depth(normal(q), position, q[0]);
        bool none = true;
        for (int i = 0; i < lane_count; ++i) {
            none = none && !(below[i] > 0);
        }
        return none;
    }
    template <class S>
    static Vec3<S> force(const SurfacePoint<S>& p, const S* q) {
        using R = typename ScalarOf<S>::type;
        const Vec3<S> n = normal(q);
        const S below = depth(n, p.position, q[0]);
        const S pressing = select(value_of(below) > decltype(value_of(below)){}, below, S{});
        const S normal_force = q[5] * p.area * pressing;
        const S normal_speed = dot(n, p.velocity);
        const Vec3<S> slip = p.velocity - normal_speed * n;
        const S speed = square_root(dot(slip, slip) + R(4e-4));
        const S friction = q[4] * normal_force / speed;
        return normal_force * n - friction * slip;
    }
};

}  // namespace mphygs
