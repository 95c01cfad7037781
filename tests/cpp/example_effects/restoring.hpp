// Hydrostatic lift: a body that floats is pushed back along the vertical, -k (z - level), per mass.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Restoring {
    static constexpr EffectInfo info{
        .name = "restoring",
        .summary = "pull towards a level, -k (z - level) per mass",
        .site = Site::body,
        .parameters = {{"k", "1/s^2", 0, 0, 1e6, 10, true},
                       {"level", "m", 0, -100, 100, 0.1, false}},
    };
    template <class S>
    static Vec3<S> acceleration(const BodyPoint<S>& p, const S* q) {
        return {{S{}, S{}, -q[0] * (p.position[2] - q[1])}};
    }
};

}  // namespace mphygs
