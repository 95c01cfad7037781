// What acts on a run's directions from outside: effects at places, the caller's own effects, the holds.
#pragma once

#include "mphygs/total_lagrangian/direction_accelerations.hpp"

namespace mphygs {

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::place_forces(double time) {
    if (!model_.sites_.point) {
        return;
    }
    const std::size_t count = static_cast<std::size_t>(model_.sites_.point_parameters);
    std::vector<D> q(count);
    for (std::size_t p = 0; p < model_.places_.size(); ++p) {
        const auto& place = model_.places_[p];
        const MaterialPoint<T> now = value_.material_point(p, time);
        for (std::size_t s = 0; s < slabs_; ++s) {
            MaterialPoint<D> m;
            m.time = now.time;
            for (int c = 0; c < 3; ++c) {
                m.rest[c] = dual(now.rest[c], W{});
                m.position[c] = dual(now.position[c], W{});
                m.velocity[c] = dual(now.velocity[c], W{});
                for (std::size_t a = 0; a < 27; ++a) {
                    const std::size_t i = s * slab_ + 3 * static_cast<std::size_t>(place.node[a]) + static_cast<std::size_t>(c);
                    m.position[c].d[0] += place.value[a] * u_[i];
                    m.velocity[c].d[0] += place.value[a] * v_[i];
                }
            }
            for (std::size_t i = 0; i < count; ++i) {
                q[i] = dual(value_.inputs_.plain(&Fields<T>::place_effect, p * count + i), lanes(&Fields<T>::place_effect, s, p * count + i));
            }
            const Vec3<D> force = evaluate_point(model_.slots_, q.data(), m);
            for (std::size_t a = 0; a < 27; ++a) {
                W* to = &f_[s * slab_ + 3 * static_cast<std::size_t>(place.node[a])];
                for (int c = 0; c < 3; ++c) {
                    to[c] += place.value[a] * force[c].d[0];
                }
            }
        }
    }
}

/// What tendons, pressures and known loads do more in every direction, at the values' state.
template <class T, int L>
inline void TotalLagrangianDirections<T, L>::actuate(int n, int frame, double dt) {
    if (!value_.actuation_) {
        return;
    }
    ActuationStep& loads = *value_.actuation_;
    const TargetBasis basis = value_.target_basis(n, frame, dt);
    const auto enter = [&](const Fields<T>& fields) {
        loads.channels_of(&fields.channel, static_cast<std::size_t>(frame), basis.value);
        value_.pose_loads(loads, fields, n);
    };
    value_.look(loads, value_.u_.data(), stride_, 1);
    enter(*value_.inputs_.primal);
    loads.value();
    for (std::size_t k = 0; k < directions_.size(); ++k) {
        value_.look(loads, reinterpret_cast<const T*>(&u_[k / width * slab_]) + k % width, width, 3 * width);
        enter(*directions_[k]);
        loads.change();
        value_.push(loads, reinterpret_cast<T*>(&f_[k / width * slab_]) + k % width, width, 3 * width);
    }
}

/// What the hook is shown: all quadrature points in the caller's order, the values and then the directions.
template <class T, int L>
inline void TotalLagrangianDirections<T, L>::hook_forces(double time, double dt) {
    if (!hook_) {
        return;
    }
    PointState<T> state = value_.hook_state(time, dt);
    const std::size_t points = 8 * model_.rows_.size(), shown = 1 + directions_.size();
    state.lanes = static_cast<int>(shown);
    state.first_direction = first_direction_;
    state.position.resize(shown * points * 3);
    state.velocity.resize(shown * points * 3);
    state.deformation.resize(shown * points * 9);
    alignas(64) Points gradient;
    Vec3<W> u[lane_count], v[lane_count];
    for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const std::size_t table = static_cast<std::size_t>(model_.table_[b]);
        const Mat3<Pack<T>> moved =
            Mat3<Pack<T>>::identity() + gather_gradient<T>(value_.u_.data(), stride_, rows, model_.gradients_[table]);
        for (std::size_t s = 0; s < slabs_; ++s) {
            gather_direction_values<W, T>(&u_[s * slab_], rows, model_.values_[table], u);
            gather_direction_values<W, T>(&v_[s * slab_], rows, model_.values_[table], v);
            gather_directions<W, T>(&u_[s * slab_], rows, model_.gradients_[table], gradient);
            for (int q = 0; q < lane_count; ++q) {
                const std::size_t at = 8 * (s * model_.rows_.size() + b) + static_cast<std::size_t>(q);
                Mat3<W> df = at_point(gradient, q);
                if (value_.prestressed_) {
                    df = product(df, in_lane(value_.f0_[b], q));
                    df = f0_.empty() ? df : df + product(in_lane(moved, q), f0_[at]);
                }
                for (std::size_t l = 0; l < width && s * width + l < directions_.size(); ++l) {
                    const std::size_t i = (1 + s * width + l) * points + 8 * static_cast<std::size_t>(model_.order_[b]) + static_cast<std::size_t>(q);
                    for (std::size_t c = 0; c < 3; ++c) {
                        state.position[3 * i + c] = u[q][static_cast<int>(c)][l];
                        state.velocity[3 * i + c] = v[q][static_cast<int>(c)][l];
                        for (std::size_t j = 0; j < 3; ++j) {
                            state.deformation[9 * i + 3 * c + j] = df.e[c][j][l];
                        }
                    }
                }
            }
        }
    }
    const PointForces<T> given = hook_->forward(state);
    const auto of_values = [points](const std::vector<T>& all, std::size_t numbers) {
        return std::vector<T>(all.begin(), all.begin() + static_cast<std::ptrdiff_t>(all.empty() ? 0 : points * numbers));
    };
    given_ = {of_values(given.force, 3), of_values(given.stress, 9)};
    Vec3<W> force[lane_count];
    for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
        const Rows& rows = *reinterpret_cast<const Rows*>(model_.rows_[b].data());
        const std::size_t table = static_cast<std::size_t>(model_.table_[b]);
        for (std::size_t s = 0; s < slabs_; ++s) {
            for (int q = 0; q < lane_count; ++q) {
                const std::size_t here = 8 * static_cast<std::size_t>(model_.order_[b]) + static_cast<std::size_t>(q);
                const std::size_t at = 8 * (s * model_.rows_.size() + b) + static_cast<std::size_t>(q);
                const auto lane = [&](const std::vector<T>& from, std::size_t numbers, std::size_t i) {
                    T of[width] = {};
                    for (std::size_t l = 0; l < width && s * width + l < directions_.size(); ++l) {
                        of[l] = from[((1 + s * width + l) * points + here) * numbers + i];
                    }
                    return read<W>(of);
                };
                for (std::size_t c = 0; c < 3 && !given.force.empty(); ++c) {
                    force[q][static_cast<int>(c)] = lane(given.force, 3, c);
                }
                if (!given.stress.empty()) {
                    Mat3<D> stress, start = Mat3<D>::identity();
                    for (std::size_t i = 0; i < 9; ++i) {
                        stress.e[i / 3][i % 3] = dual(given.stress[9 * here + i], lane(given.stress, 9, i));
                        if (value_.prestressed_) {
                            start.e[i / 3][i % 3] = dual(value_.f0_[b].e[i / 3][i % 3][q], f0_.empty() ? W{} : f0_[at].e[i / 3][i % 3]);
                        }
                    }
                    stress = dual(-value_.volume_[b][q], -of(volume_, at)) * (stress * transpose(start));
                    for (int i = 0; i < 9; ++i) {
                        gradient[i / 3][i % 3 * lane_count + q] = stress.e[i / 3][i % 3].d[0];
                    }
                }
            }
            if (!given.force.empty()) {
                scatter_direction_values<W, T>(force, &f_[s * slab_], rows, model_.values_[table]);
            }
            if (!given.stress.empty()) {
                scatter_directions<W, T>(gradient, &f_[s * slab_], rows, model_.gradients_[table]);
            }
        }
    }
}

/// The values' hold, linearised: dv = dv* - d(M^-1) C^T lambda - M^-1 C^T d lambda.
template <class T, int L>
inline void TotalLagrangianDirections<T, L>::hold(int n, int frame, double dt, bool aimed, bool reacting) {
    constexpr int N = 3 * static_cast<int>(width);  // columns: component, direction
    const Constraint& constraint = value_.constraint_[0];
    const Geometry& g = model_.geometry_;
    const std::size_t rows = constraint.row_count(), nodes = constraint.nodes().size();
    if (rows == 0) {
        return;
    }
    const double give = aimed ? value_.rule(n).give() : 0.0, rate = 1.0 / dt;
    const double softness = value_.softness(n, dt, aimed);
    const std::vector<double>& lambda = value_.lambda_rows_;
    if (!inverse_mass_.empty()) {
        reaction_.assign(rows * 4, 0.0);
        pull_.assign(nodes * 4, 0.0);
        for (std::size_t r = 0; r < rows; ++r) {
            for (std::size_t c = 0; c < 3; ++c) {
                reaction_[4 * r + c] = lambda[c * rows + r];
            }
        }
        constraint.template transposed<4>(reaction_.data(), pull_.data());
    }
    std::vector<double> sums(static_cast<std::size_t>(g.hold_count));
    held_.resize(nodes * N);
    missed_.resize(rows * N);
    impulse_.resize(rows * N);
    const std::size_t poses = static_cast<std::size_t>(schedule_.total_steps()) + 1;
    for (std::size_t s = 0; s < slabs_; ++s) {
        for (std::size_t k = 0; k < nodes; ++k) {
            const std::size_t node = static_cast<std::size_t>(constraint.nodes()[k]);
            for (std::size_t c = 0; c < 3; ++c) {
                W& v = v_[s * slab_ + 3 * node + c];
                if (!inverse_mass_.empty()) {
                    v -= static_cast<T>(pull_[4 * k + c]) * inverse_mass_[s * stride_ + node];
                }
                const T* speed = reinterpret_cast<const T*>(&v);
                const T* way = reinterpret_cast<const T*>(&u_[s * slab_ + 3 * node + c]);
                double* to = &held_[k * N + c * width];
                for (std::size_t l = 0; l < width; ++l) {
                    to[l] = static_cast<double>(speed[l]) + static_cast<double>(way[l]) * rate;
                }
            }
        }
        constraint.template apply<N>(held_.data(), missed_.data());
        for (std::size_t l = 0; aimed && l < width && s * width + l < directions_.size(); ++l) {
            const Fields<T>& direction = *directions_[s * width + l];
            const double softer = give * static_cast<double>(compliance(s, l)) / (dt * dt);
            for (std::size_t c = 0; c < 3 && (softer != 0.0 || !direction.pose.empty()); ++c) {
                constraint.sum_per_hold(&lambda[c * rows], sums.data());
                for (std::size_t r = 0; r < rows; ++r) {
                    if (g.row_hold[r] < 0) {
                        continue;  // a tie: both sides move alike
                    }
                    const std::size_t h = static_cast<std::size_t>(g.row_hold[r]);
                    double target = 0.0;
                    if (!direction.pose.empty()) {
                        const T* pose = &direction.pose[(h * poses + static_cast<std::size_t>(n) + 1) * 12];
                        target = static_cast<double>(pose[9 + c]);
                        for (std::size_t k = 0; k < 3; ++k) {
                            target += static_cast<double>(pose[3 * c + k]) * g.row_target[3 * r + k];
                        }
                    }
                    missed_[r * N + c * width + l] -= target / dt + softer * sums[h];
                }
            }
        }
        constraint.template solve<N>(missed_.data(), softness, impulse_.data());
        if (reacting && sums_.wanted()) {
            react(n, frame, s);
        }
        constraint.template transposed<N>(impulse_.data(), held_.data());
        for (std::size_t k = 0; k < nodes; ++k) {
            const std::size_t node = static_cast<std::size_t>(constraint.nodes()[k]);
            for (std::size_t c = 0; c < 3; ++c) {
                alignas(64) T change[width];
                const double* from = &held_[k * N + c * width];
                for (std::size_t l = 0; l < width; ++l) {
                    change[l] = static_cast<T>(from[l]);
                }
                v_[s * slab_ + 3 * node + c] -= value_.inverse_mass_[node] * read<W>(change);
            }
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::react(int n, int frame, std::size_t slab) {
    constexpr std::size_t N = 3 * width;
    const std::size_t rows = model_.geometry_.row_count(), holds = static_cast<std::size_t>(model_.geometry_.hold_count);
    const std::size_t poses = static_cast<std::size_t>(schedule_.total_steps()) + 1;
    const std::vector<double> turn = value_.turns(0, n);
    std::vector<double> own(3 * rows), turned(turn.size()), of_values = value_.lambda_rows_;
    for (double& x : of_values) {
        x *= value_.rule(n).impulses;
    }
    for (std::size_t l = 0; l < width && slab * width + l < directions_.size(); ++l) {
        const std::size_t k = slab * width + l;
        for (std::size_t c = 0; c < 3; ++c) {
            for (std::size_t r = 0; r < rows; ++r) {
                own[c * rows + r] = value_.rule(n).impulses * impulse_[r * N + c * width + l];
            }
        }
        sums_.add(k, n, frame, own.data(), turn.data());
        const std::vector<T>& pose = directions_[k]->pose;
        for (std::size_t h = 0; h < holds && !pose.empty(); ++h) {
            for (std::size_t i = 0; i < 9; ++i) {
                turned[9 * h + i] = static_cast<double>(pose[(h * poses + static_cast<std::size_t>(n) + 1) * 12 + i]);
            }
        }
        if (!pose.empty()) {
            sums_.add(k, n, frame, of_values.data(), turned.data(), false);
        }
    }
}

}  // namespace mphygs
