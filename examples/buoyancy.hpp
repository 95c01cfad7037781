// A body in water: what it displaces carries it, as long as it is below the level, and not above.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Buoyancy {
    static constexpr EffectInfo info{
        .name = "buoyancy",
        .summary = "lift of the water displaced, below a level",
        .site = Site::body,
        .parameters = {{"lift", "m/s^2", 0, 0, 1e4, 10, true}, {"level", "m", 0, -100, 100, 0.1, false}},
    };
    template <class S>
    static Vec3<S> acceleration(const BodyPoint<S>& p, const S* q) {
        return {{S{}, S{}, select(p.position[2] < q[1], q[0], S{})}};
    }
};

}  // namespace mphygs
