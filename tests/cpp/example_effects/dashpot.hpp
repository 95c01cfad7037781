// A damper from a material point to the room, -c v.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Dashpot {
    static constexpr EffectInfo info{
        .name = "dashpot",
        .summary = "damper from a material point to the room, -c v",
        .site = Site::point,
        .parameters = {{"c", "N s/m", 0, 0, 1e3, 0.1, true}},
    };
    template <class S>
    static Vec3<S> force(const MaterialPoint<S>& p, const S* q) {
        return (-q[0]) * p.velocity;
    }
};

}  // namespace mphygs
