// Uniform swelling or shrinking: F = F_e exp(rate t). Mass is kept.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Eigenstrain {
    static constexpr EffectInfo info{
        .name = "eigenstrain",
        .summary = "uniform growth, F = F_e exp(rate t)",
        .site = Site::volume,
        .parameters = {{"rate", "1/s", 0, -1, 1, 0.01, true}},
    };
    static constexpr int uniform_count = 1;
    template <class S>
    static void uniforms(const S* p, typename ScalarOf<S>::type time, typename ScalarOf<S>::type, S* q) {
        q[0] = exponential(-(p[0] * time));
    }
    template <class S>
    static void strain(VolumePoint<S>& p, const S* q) {
        p.elastic = q[0] * p.elastic;
        p.factor = q[0] * p.factor;
        p.strained = true;
    }
};

}  // namespace mphygs
