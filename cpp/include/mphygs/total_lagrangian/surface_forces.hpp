// Forces on the exposed surface.
#pragma once

#include "mphygs/total_lagrangian/forces.hpp"

namespace mphygs {

template <class T, int K>
inline auto TotalLagrangianForces<T, K>::surface_point(std::size_t b, double time) const -> SurfacePoint<S> {
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.surface_rows_[b].data());
    const ValueTable<T>& table = model_.surface_values_[b];
    SurfacePoint<S> p;
    for (int l = 0; l < used_; ++l) {
        const Vec3<Pack<T>> u = gather_value<T>(u_.data() + at(l, 0, 0), stride_, rows, table);
        const Vec3<Pack<T>> v = gather_value<T>(v_.data() + at(l, 0, 0), stride_, rows, table);
        const Vec3<Pack<T>> x = l == 0 ? surface_position(b, u) : u;
        for (int c = 0; c < 3; ++c) {
            lane_of(p.position[c], l) = x[c];
            lane_of(p.velocity[c], l) = v[c];
        }
    }
    p.area = S(surface_area_[b]);
    p.time = static_cast<T>(time);
    return p;
}

template <class T, int K>
inline auto TotalLagrangianForces<T, K>::surface_position(std::size_t b, const Vec3<Pack<T>>& displacement) const -> Vec3<Pack<T>> {
    const double* rest = &model_.geometry_.surface_points[24 * static_cast<std::size_t>(model_.surface_order_[b])];
    Vec3<Pack<T>> x = displacement;
    for (int c = 0; c < 3; ++c) {
        for (int q = 0; q < 8; ++q) {
            x[c][q] += static_cast<T>(rest[3 * q + c]);
        }
    }
    return x;
}

template <class T, int K>
inline void TotalLagrangianForces<T, K>::surface_forces(std::size_t b, double time, T* out, std::size_t span) const {
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.surface_rows_[b].data());
    const ValueTable<T>& table = model_.surface_values_[b];
    if (model_.sites_.out_of_reach) {
        const Vec3<Pack<T>> x = surface_position(b, gather_value<T>(u_.data(), stride_, rows, table));
        if (surface_out_of_reach(model_.slots_, value_uniforms_.data(), x)) {
            return;
        }
    }
    const Vec3<S> force = evaluate_surface(model_.slots_, uniforms_.data(), surface_point(b, time));
    for (int l = 0; l < used_; ++l) {
        Vec3<Pack<T>> part;
        for (int c = 0; c < 3; ++c) {
            part[c] = lane_of(force[c], l);
        }
        scatter_value<T>(part, out + static_cast<std::size_t>(l) * 3 * span, span, rows, table);
    }
}

}  // namespace mphygs
