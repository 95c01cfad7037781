// The material locks beyond a stretch: energy 1/2 k <I1 - 3 - limit>^2, nothing below the limit.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Locking {
    static constexpr EffectInfo info{
        .name = "locking",
        .summary = "stiff beyond a stretch, 1/2 k <I1 - 3 - limit>^2",
        .site = Site::volume,
        .threshold = true,
        .parameters = {{"limit", "-", 1e3, 1e-4, 1e3, 0.1, true, Role::level, 1e-3, 1},
                       {"k", "Pa", 0, 0, 1e9, 1e5, true}},
    };
    /// At rest nothing is beyond the limit, and the stable step would not know of the stiffness there.
    static void worst_case(double* q) { q[0] = -1e-6; }
    /// P = 2 k <I1 - 3 - limit> F
    template <class S>
    static void stress(VolumePoint<S>& p, const S* q) {
        using R = typename ScalarOf<S>::type;
        const S beyond = inner(p.elastic, p.elastic) - R(3) - q[0];
        const S excess = select(value_of(beyond) > decltype(value_of(beyond)){}, beyond, S{});
        const Mat3<S> added = (R(2) * q[1] * excess) * p.elastic;
        p.stress = p.stress + (p.strained ? added * transpose(p.factor) : added);
    }
};

}  // namespace mphygs
