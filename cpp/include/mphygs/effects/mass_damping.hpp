// Body force proportional to momentum, -alpha m v.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

struct MassDamping {
    static constexpr EffectInfo info{"mass_damping", "body force -alpha m v", Site::body, false, false, 0, 1,
                                     {{"alpha", "1/s", 0, 0, 1000, 1, true}}};
    template <class S>
    static Vec3<S> acceleration(const BodyPoint<S>& p, const S* q) {
        return (-q[0]) * p.velocity;
    }
};

}  // namespace mphygs
