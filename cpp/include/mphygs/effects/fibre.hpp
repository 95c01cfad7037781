// Transverse isotropy: energy 1/2 k_f (I4 - 1)^2, I4 = |F a|^2, along a direction a at rest.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Fibre {
    static constexpr EffectInfo info{
        .name = "fibre",
        .summary = "stiffness along a direction, 1/2 k_f (I4 - 1)^2",
        .site = Site::volume,
        .parameters = {{"k_f", "Pa", 0, 0, 1e9, 1e4, true},
                       {"a_x", "-", 0, -1, 1, 1, false, Role::axis},
                       {"a_y", "-", 0, -1, 1, 1, false, Role::axis},
                       {"a_z", "-", 1, -1, 1, 1, false, Role::axis}},
    };
    /// P = 2 k_f (I4 - 1) (F_e a) (factor a)^T, F_e = F factor the part of F that stores energy
    template <class S>
    static void stress(VolumePoint<S>& p, const S* q) {
        using R = typename ScalarOf<S>::type;
        const Vec3<S> a{{q[1], q[2], q[3]}};
        const Vec3<S> fa = p.elastic * a;
        const S scale = R(2) * q[0] * (dot(fa, fa) - dot(a, a));
        const Vec3<S> b = p.strained ? p.factor * a : a;
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                p.stress[i][j] = p.stress[i][j] + scale * fa[i] * b[j];
            }
        }
    }
};

}  // namespace mphygs
