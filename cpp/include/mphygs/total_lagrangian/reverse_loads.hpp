// A substep backwards: what holds, loads and the observer did.
#pragma once

#include "mphygs/total_lagrangian/reverse.hpp"

namespace mphygs {

template <class T>
inline void TotalLagrangianReverse<T>::reverse_actuation(int n, int frame, double dt) {
    if (!run_.actuation_) {
        return;
    }
    ActuationStep& loads = *run_.actuation_;
    const Actuation& a = model_.geometry_.actuation;
    const Fields<T>& fields = *run_.inputs_.primal;
    const TargetBasis basis = run_.target_basis(n, frame, dt);
    run_.look(loads, run_.u_.data(), run_.stride_, 1);
    loads.channels_of(&fields.channel, index(frame), basis.value);
    run_.pose_loads(loads, fields, n);
    loads.value();
    for (std::size_t i = 0; i < loads.pushed.size(); ++i) {
        loads.pushed[i] = static_cast<double>(fbar_[run_.at(0, i % 3, static_cast<std::size_t>(a.pushed_carriers()[i / 3]))]);
    }
    loads.reverse();
    loads.add_channels_bar(index(frame), basis.value, channel_bar_);
    for (std::size_t i = 0; i < loads.seen.size(); ++i) {
        ubar_[run_.at(0, i % 3, static_cast<std::size_t>(a.read_carriers()[i / 3]))] += static_cast<T>(loads.seen[i]);
    }
    for (std::size_t i = 0; i < loads.poses.size(); ++i) {
        double* to = &pose_bar_[run_.pose_at(i / 12, n) + i % 12];
        const double at = run_.rule(n).within;
        to[0] += (1.0 - at) * loads.poses[i];
        to[12] += at * loads.poses[i];
    }
}

template <class T>
inline void TotalLagrangianReverse<T>::reverse_observer(int n, int frame, double dt) {
    const auto& observer = run_.observer_;
    if (!pulled_) {
        return;
    }
    observer->ask_bar(index(frame), run_.target_basis(n, frame, dt), asked_bar_, target_bar_, blend_bar_);
    const std::vector<std::size_t>& read = observer->read_carriers();
    for (std::size_t k = 0; k < read.size(); ++k) {
        for (std::size_t c = 0; c < 3; ++c) {
            const T bar = blend_bar_[ObserverRows<T>::quad * k + c];
            ubar_[run_.at(0, c, read[k])] += observer->stiffness() * bar;
            vbar_[run_.at(0, c, read[k])] += observer->damping() * bar;
        }
    }
}

template <class T>
inline void TotalLagrangianReverse<T>::reverse_hold(int n, const Record& r, const std::vector<double>& impulses, double dt, bool aimed) {
    const Constraint& constraint = run_.constraint_[0];
    const std::size_t rows = constraint.row_count();
    if (rows == 0) {
        return;
    }
    const Geometry& g = model_.geometry_;
    const double give = aimed ? run_.rule(n).give() : 0.0;
    const double softness = run_.softness(n, dt, aimed);
    const std::size_t pose_steps = static_cast<std::size_t>(schedule_.total_steps()) + 1;
    const std::vector<std::int32_t>& nodes = constraint.nodes();
    constexpr int N = 4;  // the components, in a whole pack
    std::vector<double> at_nodes(nodes.size() * N), s(rows * N), q(rows * N), reaction(rows * N);
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t k = 0; k < nodes.size(); ++k) {
            const std::size_t node = static_cast<std::size_t>(nodes[k]);
            at_nodes[N * k + c] = static_cast<double>(run_.inverse_mass_[node] * vbar_[c * run_.stride_ + node]);
        }
        for (std::size_t k = 0; k < rows; ++k) {
            reaction[N * k + c] = impulses[c * rows + k];
        }
    }
    constraint.template apply<N>(at_nodes.data(), s.data());
    if (aimed) {
        reverse_reaction(n, r, s);
    }
    constraint.template solve<N>(s.data(), softness, q.data());
    constraint.template transposed<N>(q.data(), at_nodes.data());
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t k = 0; k < nodes.size(); ++k) {
            const std::size_t i = c * run_.stride_ + static_cast<std::size_t>(nodes[k]);
            vbar_[i] -= static_cast<T>(at_nodes[N * k + c]);
            ubar_[i] -= static_cast<T>(at_nodes[N * k + c] / dt);
        }
    }
    constraint.template transposed<N>(reaction.data(), at_nodes.data());
    std::vector<double> sums(static_cast<std::size_t>(g.hold_count)), carried(sums.size()), column(rows);
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t k = 0; k < nodes.size(); ++k) {
            const std::size_t node = static_cast<std::size_t>(nodes[k]);
            inverse_mass_bar_[node] -= at_nodes[N * k + c] * static_cast<double>(vbar_[c * run_.stride_ + node]);
        }
        if (!aimed) {
            continue;
        }
        for (std::size_t k = 0; k < rows; ++k) {
            column[k] = q[N * k + c];
            if (g.row_hold[k] < 0) {
                continue;
            }
            const std::size_t hold = static_cast<std::size_t>(g.row_hold[k]);
            double* pose = &pose_bar_[(hold * pose_steps + static_cast<std::size_t>(n) + 1) * 12];
            pose[9 + c] += column[k] / dt;
            for (std::size_t j = 0; j < 3; ++j) {
                pose[3 * c + j] += column[k] / dt * g.row_target[3 * k + j];
            }
        }
        constraint.sum_per_hold(column.data(), sums.data());
        constraint.sum_per_hold(&impulses[c * rows], carried.data());
        for (std::size_t k = 0; k < sums.size(); ++k) {
            compliance_bar_ += give * sums[k] * carried[k] / (dt * dt);
        }
    }
}

template <class T>
inline void TotalLagrangianReverse<T>::reverse_reaction(int n, const Record& r, std::vector<double>& s) {
    if (bar_.reaction.empty()) {
        return;
    }
    const Geometry& g = model_.geometry_;
    const std::size_t rows = g.row_count(), holds = static_cast<std::size_t>(g.hold_count), frame = index(step_frame_[index(n)]);
    const std::size_t pose_steps = static_cast<std::size_t>(schedule_.total_steps()) + 1;
    const std::vector<double> turn = run_.turns(0, n);
    std::vector<double> impulse_bar(3 * rows, 0.0), turn_bar(9 * holds, 0.0);
    for (std::size_t side = 0; side < 2; ++side) {
        const double share = run_.rule(n).impulses * schedule_.reaction_weight[2 * index(n) + side] / step_dt_[index(n)];
        add_wrench_bars(g, r.reactions.data(), turn.data(), share, &bar_.reaction[(frame + side) * holds * wrench_size],
                        impulse_bar.data(), turn_bar.data());
    }
    for (std::size_t c = 0; c < 3; ++c) {
        for (std::size_t k = 0; k < rows; ++k) {
            s[4 * k + c] -= impulse_bar[c * rows + k];
        }
    }
    for (std::size_t h = 0; h < holds; ++h) {
        for (std::size_t i = 0; i < 9; ++i) {
            pose_bar_[(h * pose_steps + index(n) + 1) * 12 + i] += turn_bar[9 * h + i];
        }
    }
}

template <class T>
inline void TotalLagrangianReverse<T>::reverse_accelerations(int n, const Record& r, double time, double dt, double span) {
    const T h = static_cast<T>(span);
    const int frame = step_frame_[index(n)];
    for (std::size_t c = 0; c < 3; ++c) {
        double gravity = 0;
        for (std::size_t i = 0; i < model_.node_count(); ++i) {
            const std::size_t k = run_.at(0, c, i);
            const T abar = h * vbar_[k];
            gravity += static_cast<double>(abar);
            fbar_[k] = abar * run_.inverse_mass_[i];
            inverse_mass_bar_[i] += static_cast<double>(abar) * static_cast<double>(r.f[k]);
            if (!node_force_bar_.empty()) {
                node_force_bar_[(static_cast<std::size_t>(frame) * model_.node_count() + i) * 3 + c] += fbar_[k];
            }
        }
        gravity_bar_[c] += gravity;
    }
    pulled_ = run_.observer_ && run_.observer_->pulls(index(frame));
    if (pulled_) {
        run_.observer_->pull_bar(h, vbar_.data(), asked_bar_);
    }
    all_uniforms(model_.slots_, run_.parameters_.data(), static_cast<T>(time), static_cast<T>(dt), run_.plain_uniforms_.data());
    for (std::size_t i = 0; i < run_.uniforms_.size(); ++i) {
        run_.uniforms_[i] = broadcast<T>(run_.plain_uniforms_[i]);
    }
    for (auto& u : chunk_uniform_bar_) {
        std::fill(u.begin(), u.end(), 0.0);
    }
    if (model_.sites_.body) {
        reverse_body(time, h);
    }
    if (model_.sites_.point) {
        reverse_places(time);
    }
    if (run_.inputs_.hook) {
        reverse_hook(time, dt);
    }
    run_.team_->each(static_cast<int>(model_.chunks_.size()), [&](int c) {
        reverse_chunk(static_cast<std::size_t>(c), time, dt);
    });
    for (std::size_t c = 0; c < model_.chunks_.size(); ++c) {
        const auto& chunk = model_.chunks_[c];
        const std::size_t span = static_cast<std::size_t>(chunk.node_end - chunk.node_begin);
        const std::size_t used = std::min(span, run_.stride_ - static_cast<std::size_t>(chunk.node_begin));
        for (std::size_t k = 0; k < 3; ++k) {
            T* u = ubar_.data() + k * run_.stride_ + chunk.node_begin;
            T* v = vbar_.data() + k * run_.stride_ + chunk.node_begin;
            for (std::size_t i = 0; i < used; ++i) {
                u[i] += chunk_bar_[c][k * span + i];
                v[i] += chunk_bar_[c][(3 + k) * span + i];
            }
        }
    }
    reverse_uniforms(time, dt);
    reverse_observer(n, frame, step_dt_[index(n)]);
    reverse_actuation(n, frame, step_dt_[index(n)]);
}

}  // namespace mphygs
