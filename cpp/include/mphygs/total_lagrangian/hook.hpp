// What the caller's own effects see of a total-Lagrangian run and give to it.
#pragma once

#include "mphygs/total_lagrangian/run_loads.hpp"
#include "mphygs/total_lagrangian/run_nodes.hpp"

namespace mphygs {

template <class T, int K>
inline PointState<T> TotalLagrangianRun<T, K>::hook_state(double time, double dt) const {
    const std::size_t points = 8 * model_.rows_.size();
    PointState<T> s;
    s.time = time;
    s.first_direction = inputs_.first_direction;
    for (int k = 0; k < K; ++k) {
        s.lanes += inputs_.direction[k] ? 1 : 0;
    }
    const std::size_t shown = static_cast<std::size_t>(s.lanes);
    s.position.resize(shown * points * 3);
    s.velocity.resize(shown * points * 3);
    s.deformation.resize(shown * points * 9);
    for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const ValueTable<T>& table = model_.values_[static_cast<std::size_t>(model_.table_[b])];
        const std::size_t from = 8 * static_cast<std::size_t>(model_.order_[b]);
        VolumePoint<S> p;
        load_point(b, p, time, dt);
        for (std::size_t l = 0; l < shown; ++l) {
            const int lane = static_cast<int>(l);
            const Vec3<Pack<T>> u = gather_value<T>(u_.data() + at(lane, 0, 0), stride_, rows, table);
            const Vec3<Pack<T>> v = gather_value<T>(v_.data() + at(lane, 0, 0), stride_, rows, table);
            const Mat3<Pack<T>> f = get_lane<Pack<T>>(p.deformation, lane);
            for (int q = 0; q < 8; ++q) {
                const std::size_t i = l * points + from + static_cast<std::size_t>(q);
                for (int c = 0; c < 3; ++c) {
                    const std::size_t to = 3 * i + static_cast<std::size_t>(c);
                    s.position[to] = u[c][q];
                    s.velocity[to] = v[c][q];
                    if (l == 0) {
                        s.position[to] += static_cast<T>(model_.geometry_.points[to]);
                    }
                    for (int j = 0; j < 3; ++j) {
                        s.deformation[3 * to + static_cast<std::size_t>(j)] = f[c][j][q];
                    }
                }
            }
        }
    }
    return s;
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::hook_forces(double time, double dt) {
    if (!inputs_.hook) {
        return;
    }
    const PointState<T> state = hook_state(time, dt);
    const PointForces<T> given = inputs_.hook->forward(state);
    const std::size_t points = 8 * model_.rows_.size();
    for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const std::size_t table = static_cast<std::size_t>(model_.table_[b]);
        const std::size_t from = 8 * static_cast<std::size_t>(model_.order_[b]);
        Mat3<S> stress;
        for (int l = 0; l < state.lanes; ++l) {
            const std::size_t first = static_cast<std::size_t>(l) * points + from;
            if (!given.force.empty()) {
                scatter_value<T>(point_vectors(&given.force[3 * first]), f_.data() + at(l, 0, 0), stride_, rows, model_.values_[table]);
            }
            if (!given.stress.empty()) {
                set_lane(stress, l, point_matrices(&given.stress[9 * first]));
            }
        }
        if (!given.stress.empty()) {
            if (prestressed_) {
                stress = stress * transpose(f0_[b]);
            }
            stress = (-volume_[b]) * stress;
            for (int l = 0; l < state.lanes; ++l) {
                scatter_gradient<T>(get_lane<Pack<T>>(stress, l), f_.data() + at(l, 0, 0), stride_, rows, model_.gradients_[table]);
            }
        }
    }
}

}  // namespace mphygs
