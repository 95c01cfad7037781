// How holds keep the nodes of a total-Lagrangian run where they are carried, all directions of the run at once.
#pragma once

#include "mphygs/total_lagrangian/run.hpp"

namespace mphygs {

template <class T, int K>
template <int First, int Count>
inline void TotalLagrangianRun<T, K>::hold_lanes(int n, double dt, bool aimed) {
    constexpr int N = Count == 1 ? 4 : 3 * Count;  // columns: lane, component; a whole pack of them
    const Constraint& constraint = constraint_[0];
    const Geometry& g = model_.geometry_;
    const std::size_t rows = constraint.row_count(), nodes = constraint.nodes().size();
    const double give = aimed ? rule(n).give() : 0.0, rate = 1.0 / dt;
    const double softness = this->softness(n, dt, aimed);
    held_.assign(nodes * N, 0.0);
    missed_.assign(rows * N, 0.0);
    impulse_.assign(rows * N, 0.0);
    for (int l = First; l < First + Count; ++l) {
        for (std::size_t c = 0; c < 3; ++c) {
            const std::size_t column = static_cast<std::size_t>(l - First) * 3 + c;
            T* v = v_.data() + at(l, c, 0);
            const T* u = u_.data() + at(l, c, 0);
            const T* slope = &inverse_mass_[static_cast<std::size_t>(l) * stride_];
            for (std::size_t k = 0; k < nodes; ++k) {
                const std::size_t node = static_cast<std::size_t>(constraint.nodes()[k]);
                if constexpr (First > 0) {
                    v[node] -= slope[node] * static_cast<T>(pull_[4 * k + c]);  // - d(M^-1) C^T lambda
                }
                held_[k * N + column] = static_cast<double>(v[node]) + static_cast<double>(u[node]) * rate;
            }
        }
    }
    constraint.template apply<N>(held_.data(), missed_.data());
    std::vector<double> sums(static_cast<std::size_t>(g.hold_count));
    for (int l = First; l < First + Count; ++l) {
        for (std::size_t c = 0; c < 3; ++c) {
            const std::size_t column = static_cast<std::size_t>(l - First) * 3 + c;
            if (!aimed) {
                continue;
            }
            const double softer = l > 0 ? give * static_cast<double>(lane_of(compliance_, l)) / (dt * dt) : 0.0;
            if (softer != 0.0) {
                constraint.sum_per_hold(&lambda_rows_[c * rows], sums.data());
            }
            for (std::size_t r = 0; r < rows; ++r) {
                if (g.row_hold[r] < 0) {
                    continue;  // a tie: both sides move alike
                }
                const std::size_t h = static_cast<std::size_t>(g.row_hold[r]);
                double target = pose(l, h, n + 1, 9 + c);
                for (std::size_t k = 0; k < 3; ++k) {
                    target += pose(l, h, n + 1, 3 * c + k) * g.row_target[3 * r + k];
                }
                if (l == 0) {
                    target -= g.row_target[3 * r + c];
                }
                missed_[r * N + column] -= target / dt;
                if (softer != 0.0) {
                    missed_[r * N + column] -= softer * sums[h];
                }
            }
        }
    }
    constraint.template solve<N>(missed_.data(), softness, impulse_.data());
    constraint.template transposed<N>(impulse_.data(), held_.data());
    for (int l = First; l < First + Count; ++l) {
        for (std::size_t c = 0; c < 3; ++c) {
            const std::size_t column = static_cast<std::size_t>(l - First) * 3 + c;
            T* v = v_.data() + at(l, c, 0);
            for (std::size_t k = 0; k < nodes; ++k) {
                const std::size_t node = static_cast<std::size_t>(constraint.nodes()[k]);
                v[node] -= inverse_mass_[node] * static_cast<T>(held_[k * N + column]);
            }
            double* lambda = &lambda_rows_[(static_cast<std::size_t>(l) * 3 + c) * rows];
            for (std::size_t r = 0; r < rows; ++r) {
                lambda[r] = impulse_[r * N + column];
            }
        }
    }
    if constexpr (First == 0 && lanes > 1) {
        pull_ = held_;
    }
}

template <class T, int K>
inline auto TotalLagrangianRun<T, K>::turns(int lane, int n) const -> std::vector<double> {
    std::vector<double> turn;
    for (std::size_t h = 0; h < static_cast<std::size_t>(model_.geometry_.hold_count); ++h) {
        for (std::size_t i = 0; i < 9; ++i) {
            turn.push_back(pose(lane, h, n + 1, i));
        }
    }
    return turn;
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::react(int n, int frame) {
    const std::vector<double> turn = turns(0, n);
    for (int l = 0; l < lanes; ++l) {
        const std::size_t lane = static_cast<std::size_t>(l);
        sums_.add(lane, n, frame, &lambda_rows_[lane * 3 * model_.geometry_.row_count()], turn.data());
        if (l > 0) {
            sums_.add(lane, n, frame, lambda_rows_.data(), turns(l, n).data(), false);
        }
    }
}

}  // namespace mphygs
