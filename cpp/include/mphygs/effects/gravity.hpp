// Correction of the gravity vector: tilt or wrong magnitude.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Gravity {
    static constexpr EffectInfo info{
        .name = "gravity",
        .summary = "correction of the gravity vector",
        .site = Site::body,
        .loads_at_rest = true,
        .corrects_gravity = true,
        .parameters = {{"delta_g_x", "m/s^2", 0, -20, 20, 0.5, true},
                       {"delta_g_y", "m/s^2", 0, -20, 20, 0.5, true},
                       {"delta_g_z", "m/s^2", 0, -20, 20, 0.5, true}},
    };
    template <class S>
    static Vec3<S> acceleration(const BodyPoint<S>&, const S* q) {
        return {{q[0], q[1], q[2]}};
    }
};

}  // namespace mphygs
