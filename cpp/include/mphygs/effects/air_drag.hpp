// Drag of still air on the exposed surface, -1/2 rho_air c_d A |v| v, rho_air = 1.2 kg/m^3.
#pragma once

#include "mphygs/effect.hpp"

namespace mphygs {

/// -1/2 rho_air c_d A |w| w for the velocity w of the surface against the air [N].
template <class S>
inline Vec3<S> quadratic_drag(const Vec3<S>& w, const S& area, const S& drag_coefficient) {
    using R = typename ScalarOf<S>::type;
    // The small number keeps the square root differentiable at rest; its force is 1e-12 of a unit one.
    const S speed = square_root(dot(w, w) + R(1e-12));
    const S scale = R(-0.6) * drag_coefficient * area * speed;
    return scale * w;
}

struct AirDrag {
    static constexpr EffectInfo info{
        .name = "air_drag",
        .summary = "drag of still air on the exposed surface",
        .site = Site::surface,
        .parameters = {{"c_d", "-", 0, 0, 100, 1, true}},
    };
    static constexpr bool reads_position = false;
    template <class S>
    static Vec3<S> force(const SurfacePoint<S>& p, const S* q) {
        return quadratic_drag(p.velocity, p.area, q[0]);
    }
};

}  // namespace mphygs
