// Adjoint of what the caller's own effects give to a total-Lagrangian run.
#pragma once

#include "mphygs/total_lagrangian/block_reverse.hpp"

namespace mphygs {

template <class T>
inline void TotalLagrangianForcesReverse<T>::reverse_hook(double time, double dt) {
    const std::size_t points = 8 * model_.rows_.size();
    const PointState<T> state = run_.hook_state(time, dt);
    const PointForces<T> given = run_.inputs_.hook->forward(state);
    PointForces<T> bar;
    bar.force.resize(given.force.size());
    bar.stress.resize(given.stress.size());
    std::vector<Mat3<Pack<T>>> pulled(given.stress.empty() ? 0 : model_.rows_.size());
    for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const std::size_t table = static_cast<std::size_t>(model_.table_[b]);
        const std::size_t from = 8 * static_cast<std::size_t>(model_.order_[b]);
        if (!given.force.empty()) {
            const Vec3<Pack<T>> force_bar = gather_value<T>(fbar_.data(), run_.stride_, rows, model_.values_[table]);
            for (std::size_t i = 0; i < 24; ++i) {
                bar.force[3 * from + i] = force_bar[static_cast<int>(i % 3)][i / 3];
            }
        }
        if (!given.stress.empty()) {
            const Mat3<Pack<T>> g = gather_gradient<T>(fbar_.data(), run_.stride_, rows, model_.gradients_[table]);
            const Mat3<Pack<T>> stress = Run::point_matrices(&given.stress[9 * from]);
            pulled[b] = run_.prestressed_ ? g * run_.f0_[b] : g;
            for (std::size_t i = 0; i < 72; ++i) {
                const int j = static_cast<int>(i % 9);
                bar.stress[9 * from + i] = -run_.volume_[b][i / 9] * pulled[b][j / 3][j % 3][i / 9];
            }
            accumulate(&volume_bar_[from], -inner(pulled[b], stress));
            if (run_.prestressed_) {
                add_deformation0_bar(from, (-run_.volume_[b]) * (transpose(g) * stress));
            }
        }
    }
    const PointForces<T> whole = bar;
    if (run_.schedule_.implicit) {
        for (std::size_t i = 0; i < hook_told_.force.size(); ++i) {
            bar.force[i] -= hook_told_.force[i];
        }
        for (std::size_t i = 0; i < hook_told_.stress.size(); ++i) {
            bar.stress[i] -= hook_told_.stress[i];
        }
    }
    PointState<T> state_bar = run_.inputs_.hook->reverse(state, bar);
    if (state_bar.position.size() != 3 * points || state_bar.velocity.size() != 3 * points ||
        state_bar.deformation.size() != 9 * points) {
        throw std::invalid_argument("the hook's bars must have the sizes of the state");
    }
    if (run_.schedule_.implicit) {
        const auto add = [](std::vector<T>& to, const std::vector<T>& from) {
            for (std::size_t i = 0; i < from.size(); ++i) {
                to[i] += from[i];
            }
        };
        add(state_bar.position, hook_answer_.position);
        add(state_bar.velocity, hook_answer_.velocity);
        add(state_bar.deformation, hook_answer_.deformation);
        hook_told_ = whole;
        hook_answer_ = state_bar;
    }
    for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const std::size_t table = static_cast<std::size_t>(model_.table_[b]);
        const std::size_t from = 8 * static_cast<std::size_t>(model_.order_[b]);
        scatter_value<T>(Run::point_vectors(&state_bar.position[3 * from]), ubar_.data(), run_.stride_, rows, model_.values_[table]);
        scatter_value<T>(Run::point_vectors(&state_bar.velocity[3 * from]), vbar_.data(), run_.stride_, rows, model_.values_[table]);
        Mat3<Pack<T>> gradient_bar = Run::point_matrices(&state_bar.deformation[9 * from]);
        if (run_.prestressed_) {
            const Mat3<Pack<T>>& f0 = run_.f0_[b];
            VolumePoint<Pack<T>> value;
            run_.load_point(b, value, time, dt);
            add_deformation0_bar(from, transpose(value.deformation * inverse(f0)) * gradient_bar);
            gradient_bar = gradient_bar * transpose(f0);
        }
        scatter_gradient<T>(gradient_bar, ubar_.data(), run_.stride_, rows, model_.gradients_[table]);
    }
}

}  // namespace mphygs
