// A plane n.x >= d that the surface may not pass, with Coulomb friction. The length of n does not matter:
// all three of its components can be fitted, with a prior for the length.
//
// Penalty: pressure stiffness * depth on the exposed area; friction mu times it against the
// tangential velocity, smoothed below a slip of 2 cm/s.
#pragma once

#include <cmath>

#include "mphygs/effect.hpp"

namespace mphygs {

struct Contact {
    static constexpr EffectInfo info{
        .name = "contact",
        .summary = "a plane n.x >= d with Coulomb friction",
        .site = Site::surface,
        .threshold = true,
        .parameters = {{"d", "m", -1e3, -1e3, 1e3, 0.01, true, Role::offset},
                       {"n_x", "-", 0, -2, 2, 1, false, Role::direction},
                       {"n_y", "-", 0, -2, 2, 1, false, Role::direction},
                       {"n_z", "-", 1, -2, 2, 1, false, Role::direction},
                       {"mu", "-", 0, 0, 10, 0.3, true, Role::strength, 0.2, 0.2},
                       {"stiffness", "Pa/m", 0, 0, 1e12, 1e6, false}},
    };
    /// Everything touches, without friction: at such depths it would brake without bound.
    static void worst_case(double* q) {
        q[0] = 100.0;
        q[4] = 0.0;
    }
    /// As stiff as a cell of the softest part: it sinks in by micrometres where flowers touch. Ten times as
    /// stiff, the material bounces from substep to substep and no derivative is left. Rounded, so that it is
    /// constant while Young's moduli are fitted.
    static void complete(double* q, const ObjectScales& of) {
        if (q[5] == 0.0) {
            q[5] = std::exp2(std::nearbyint(std::log2(of.youngs_modulus / of.spacing)));
        }
    }
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
