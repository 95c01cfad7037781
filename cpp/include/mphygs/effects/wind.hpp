// Drag in a steady flow w, -1/2 rho_air c_d A |v - w| (v - w).
#pragma once

#include "mphygs/effects/air_drag.hpp"

namespace mphygs {

struct Wind {
    static constexpr EffectInfo info{
        .name = "wind",
        .summary = "drag of a steady flow on the exposed surface",
        .site = Site::surface,
        .loads_at_rest = true,
        .simpler = "air_drag",
        .parameters = {{"w_x", "m/s", 0, -50, 50, 1, true, Role::flow, 2, 2},
                       {"w_y", "m/s", 0, -50, 50, 1, true, Role::flow, 2, 2},
                       {"w_z", "m/s", 0, -50, 50, 1, true, Role::flow, 2, 2},
                       {"c_d", "-", 0, 0, 100, 1, true}},
    };
    static constexpr bool reads_position = false;
    template <class S>
    static Vec3<S> force(const SurfacePoint<S>& p, const S* q) {
        const Vec3<S> flow{{q[0], q[1], q[2]}};
        return quadratic_drag(p.velocity - flow, p.area, q[3]);
    }
};

}  // namespace mphygs
