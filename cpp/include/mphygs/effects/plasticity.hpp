// Von Mises yield with return mapping: permanent set.
//
// F_e <- exp(-gamma n) F_e with n the direction of the Kirchhoff stress deviator s and
// gamma = (|s| - sqrt(2/3) yield) / (2 mu), the radial return; the exponential is taken to second
// order, which is exact to round-off for the strain of one substep.
// Source: Simo, "Algorithms for static and dynamic multiplicative plasticity", 1992.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Plasticity {
    static constexpr EffectInfo info{
        .name = "plasticity",
        .summary = "von Mises yield with return mapping",
        .site = Site::volume,
        .threshold = true,
        .history_count = 9,
        .parameters = {{"yield_stress", "Pa", 1e12, 1, 1e12, 1e4, true, Role::level, 1e2, 1e6}},
    };
    /// History: inverse plastic deformation minus the identity.
    template <class S>
    static void strain(VolumePoint<S>& p, const S* q) {
        using R = typename ScalarOf<S>::type;
        Mat3<S> plastic_inverse = Mat3<S>::identity();
        for (int i = 0; i < 9; ++i) {
            plastic_inverse[i / 3][i % 3] = plastic_inverse[i / 3][i % 3] + p.history[i];
        }
        Mat3<S> trial = p.elastic * plastic_inverse;
        Mat3<S> s = elastic_stress(p.law, trial, p.mu, p.lambda) * transpose(trial);
        const S mean = R(1.0 / 3.0) * trace(s);
        for (int i = 0; i < 3; ++i) {
            s[i][i] = s[i][i] - mean;
        }
        const S norm = square_root(inner(s, s) + R(1e-12));
        const S excess = norm - R(0.816496580927726) * q[0];
        const S step = select(value_of(excess) > decltype(value_of(excess)){}, excess / (R(2) * p.mu * norm), S{});
        const Mat3<S> a = step * s;
        Mat3<S> shrink = Mat3<S>::identity() - a + constant<S>(R(0.5)) * (a * a);
        const Mat3<S> returned = shrink * trial;
        // elastic = (deformation * earlier factors) * new inverse plastic deformation
        const Mat3<S> next = inverse(p.elastic) * returned;
        for (int i = 0; i < 9; ++i) {
            p.history_next[i] = next[i / 3][i % 3] - R(i % 4 == 0 ? 1 : 0);
        }
        p.elastic = returned;
        p.factor = p.factor * next;
        p.strained = true;
    }
};

}  // namespace mphygs
