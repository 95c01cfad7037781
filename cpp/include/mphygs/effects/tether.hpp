// Spring of natural length zero from a material point to a point in space, -k (x - anchor).
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct Tether {
    static constexpr EffectInfo info{
        .name = "tether",
        .summary = "spring from a material point to a point in space",
        .site = Site::point,
        .loads_at_rest = true,
        .parameters = {{"k", "N/m", 0, 0, 1e6, 1, true},
                       {"anchor_x", "m", 0, -100, 100, 0.1, false, Role::anchor},
                       {"anchor_y", "m", 0, -100, 100, 0.1, false, Role::anchor},
                       {"anchor_z", "m", 0, -100, 100, 0.1, false, Role::anchor}},
    };
    template <class S>
    static Vec3<S> force(const MaterialPoint<S>& p, const S* q) {
        const Vec3<S> anchor{{q[1], q[2], q[3]}};
        return (-q[0]) * (p.position - anchor);
    }
};

}  // namespace mphygs
