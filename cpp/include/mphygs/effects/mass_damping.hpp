// Body force proportional to momentum, -alpha m v.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct MassDamping {
    static constexpr EffectInfo info{
        .name = "mass_damping",
        .summary = "body force -alpha m v",
        .site = Site::body,
        .parameters = {{"alpha", "1/s", 0, 0, 1000, 1, true}},
    };
    template <class S>
    static Vec3<S> acceleration(const BodyPoint<S>& p, const S* q) {
        return (-q[0]) * p.velocity;
    }
};

}  // namespace mphygs
