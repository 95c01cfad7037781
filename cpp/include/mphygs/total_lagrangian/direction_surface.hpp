// Forces of a run's directions on the exposed surface, and those of effects that single directions have besides.
#pragma once

#include "mphygs/total_lagrangian/directions.hpp"

namespace mphygs {

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::added_volume(std::size_t b, double time, double dt, T* out, std::size_t span) {
    using P = Pack<T>;
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
    const std::size_t table = static_cast<std::size_t>(model_.table_[b]);
    const bool prestressed = value_.prestressed_;
    const Mat3<P> moved = Mat3<P>::identity() + gather_gradient<T>(value_.u_.data(), stride_, rows, model_.gradients_[table]);
    const Mat3<P> deformation = prestressed ? moved * value_.f0_[b] : moved;
    Mat3<P> flow;
    if (rate_) {
        flow = gather_gradient<T>(value_.v_.data(), stride_, rows, model_.gradients_[table]);
        flow = prestressed ? flow * value_.f0_[b] : flow;
    }
    thread_local VolumePoint<typename AddedForces<T>::P> p;  // large: cleared once, written over
    p.deformation = {};
    p.rate = {};
    set_lane(p.deformation, 0, deformation);
    set_lane(p.rate, 0, flow);
    p.mu = value_.mu_[b];
    p.lambda = value_.lambda_[b];
    p.law = model_.settings_.law;
    p.time = static_cast<T>(time);
    p.dt = static_cast<T>(dt);
    for (std::size_t a = 0; a < added_.size(); ++a) {
        AddedForces<T>& forces = added_[a].forces;
        if (!forces.own().volume) {
            continue;
        }
        Mat3<P> stress = forces.stress(b, p);
        if (prestressed) {
            stress = stress * transpose(value_.f0_[b]);
        }
        scatter_gradient<T>((-value_.volume_[b]) * stress, out + 3 * a * span, span, rows, model_.gradients_[table]);
        if (forces.own().body_volume) {
            const P mass = load<T>(&value_.inputs_.primal->mass[8 * static_cast<std::size_t>(model_.order_[b])]);
            const Vec3<P> force = mass * AddedForces<T>::slope(p.acceleration);
            scatter_value<T>(force, out + 3 * a * span, span, rows, model_.values_[table]);
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::surface_forces(std::size_t b, double time, W* out, std::size_t span, T* added) {
    using P = Pack<T>;
    const Rows& rows = *reinterpret_cast<const Rows*>(model_.surface_rows_[b].data());
    const ValueTable<T>& table = model_.surface_values_[b];
    const Vec3<P> x = value_.surface_position(b, gather_value<T>(value_.u_.data(), stride_, rows, table));
    const Vec3<P> v = gather_value<T>(value_.v_.data(), stride_, rows, table);
    const P area = value_.surface_area_[b];
    for (std::size_t a = 0; a < added_.size(); ++a) {
        if (added_[a].forces.own().surface) {
            SurfacePoint<typename AddedForces<T>::P> p;
            for (int c = 0; c < 3; ++c) {
                p.position[c].v = x[c];
                p.velocity[c].v = v[c];
            }
            p.area.v = area;
            p.time = static_cast<T>(time);
            scatter_value<T>(added_[a].forces.surface(p), added + 3 * a * span, span, rows, table);
        }
    }
    if (!model_.sites_.surface || (model_.sites_.out_of_reach && surface_out_of_reach(model_.slots_, value_.value_uniforms_.data(), x))) {
        return;
    }
    Vec3<W> dx[lane_count], dv[lane_count], force[lane_count];
    for (std::size_t s = 0; s < slabs_; ++s) {
        if (model_.sites_.surface_position) {
            gather_direction_values<W, T>(&u_[s * slab_], rows, table, dx);
        }
        gather_direction_values<W, T>(&v_[s * slab_], rows, table, dv);
        for (int q = 0; q < lane_count; ++q) {
            SurfacePoint<D> p;
            for (int c = 0; c < 3; ++c) {
                p.position[c] = dual(x[c][q], dx[q][c]);
                p.velocity[c] = dual(v[c][q], dv[q][c]);
            }
            p.area = dual(area[q], W{});
            p.time = static_cast<T>(time);
            const Vec3<D> f = evaluate_surface(model_.slots_, &uniforms_[s * static_cast<std::size_t>(Registry::total_uniform_count)], p);
            for (int c = 0; c < 3; ++c) {
                force[q][c] = f[c].d[0];
            }
        }
        scatter_direction_values<W, T>(force, out + s * 3 * span, rows, table);
    }
}

}  // namespace mphygs
