// A pressure that lags behind the volume: p' + p / tau = k (ln J)', relaxed at the start.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct VolumeMemory {
    static constexpr EffectInfo info{
        .name = "volume_memory",
        .summary = "pressure with memory, p' + p/tau = k (ln J)'",
        .site = Site::volume,
        .history_count = 3,
        .parameters = {{"k", "Pa", 0, 0, 1e9, 1e4, true},
                       {"tau", "s", 0.1, 1e-4, 1e4, 0.1, true, Role::level, 0.02, 0.5}},
    };
    static constexpr int uniform_count = 2;
    template <class S>
    static void uniforms(const S* p, typename ScalarOf<S>::type, typename ScalarOf<S>::type dt, S* q) {
        const S half = exponential(-(typename ScalarOf<S>::type(0.5) * dt) / p[1]);
        q[0] = half * half;
        q[1] = p[0] * half;
    }
    /// History: 0 p, 1 ln J before the substep, 2 whether that was ever set. P += p F^-T
    template <class S>
    static void stress(VolumePoint<S>& p, const S* q) {
        using R = typename ScalarOf<S>::type;
        const Mat3<S> c = cofactor(p.deformation);
        const S j = determinant(p.deformation, c), log_j = logarithm(j);
        const S next = q[0] * p.history[0] + p.history[2] * (q[1] * (log_j - p.history[1]));
        p.history_next[0] = next;
        p.history_next[1] = log_j;
        p.history_next[2] = constant<S>(R(1));
        p.stress = p.stress + (next / j) * c;
    }
};

}  // namespace mphygs
