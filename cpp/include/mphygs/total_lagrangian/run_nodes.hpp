// Masses of the nodes, the sum of their forces, and what these do to their velocities.
#pragma once

#include "mphygs/total_lagrangian/run.hpp"

namespace mphygs {

template <class T, int K>
inline void TotalLagrangianRun<T, K>::prepare_mass() {
    std::vector<T> mass(lanes * stride_, T{});
    for (int l = 0; l < lanes; ++l) {
        const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
        T* m = &mass[static_cast<std::size_t>(l) * stride_];
        if (fields && !fields->mass.empty()) {
            for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
                const Pack<T> point = load<T>(&fields->mass[8 * static_cast<std::size_t>(model_.order_[b])]);
                const MassTable<T>& table = model_.masses_[static_cast<std::size_t>(model_.table_[b])];
                for (int a = 0; a < 27; ++a) {
                    m[model_.rows_[b][static_cast<std::size_t>(a / 3)] + a % 3] += sum_lanes<T>(point * table.by_node[a]);
                }
            }
        }
        if (fields && model_.sites_.mass && !fields->place_mass.empty()) {
            for (std::size_t p = 0; p < model_.places_.size(); ++p) {
                for (std::size_t a = 0; a < 27; ++a) {
                    m[model_.places_[p].node[a]] += fields->place_mass[p] * model_.places_[p].value[a];
                }
            }
        }
    }
    mass_ = mass;
    inverse_mass_.assign(lanes * stride_, T{});
    std::vector<double> inverse(stride_, 0.0);
    for (std::size_t n = 0; n < model_.node_count(); ++n) {
        if (mass[n] > T{}) {
            inverse[n] = 1.0 / static_cast<double>(mass[n]);
            inverse_mass_[n] = static_cast<T>(inverse[n]);
            for (int l = 1; l < lanes; ++l) {
                const std::size_t i = static_cast<std::size_t>(l) * stride_ + n;
                inverse_mass_[i] = -inverse_mass_[n] * inverse_mass_[n] * mass[i];
            }
        }
    }
    shared_mass_ = model_.shared_mass(*inputs_.primal);
    constraint_.emplace_back(model_.geometry_, model_.constraint_node_, inverse);
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::reduce_forces() {
    std::fill(f_.begin(), f_.end(), T{});
    for (std::size_t c = 0; c < model_.chunks_.size(); ++c) {
        const auto& chunk = model_.chunks_[c];
        const std::size_t span = static_cast<std::size_t>(chunk.node_end - chunk.node_begin);
        const std::size_t used = std::min(span, stride_ - static_cast<std::size_t>(chunk.node_begin));
        for (std::size_t k = 0; k < 3 * static_cast<std::size_t>(lanes); ++k) {
            const T* from = chunk_force_[c].data() + k * span;
            T* to = f_.data() + k * stride_ + chunk.node_begin;
            for (std::size_t i = 0; i < used; ++i) {
                to[i] += from[i];
            }
        }
    }
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::share_inertia(double span) {
    const MidpointState<T>& m = *midpoint_;
    push_each_other<T>(
        shared_mass_,
        [&](std::size_t n, std::size_t c) { return m.middle[at(0, c, n)] - m.v0[at(0, c, n)]; },
        [&](std::size_t n, std::size_t c, T force) { f_[at(0, c, n)] += static_cast<T>(1.0 / span) * force; });
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::update_nodes(double time, double dt) {
    const T h = static_cast<T>(dt);
    Vec3<S> gravity;
    for (int c = 0; c < 3; ++c) {
        for (int l = 0; l < lanes; ++l) {
            lane_of(gravity[c], l) = broadcast<T>(lane_of(gravity_[c], l));
        }
    }
    for (std::size_t n = 0; n < stride_; n += lane_count) {
        S inverse_mass{};
        for (int l = 0; l < lanes; ++l) {
            lane_of(inverse_mass, l) = load<T>(&inverse_mass_[static_cast<std::size_t>(l) * stride_ + n]);
        }
        Vec3<S> acceleration = gravity;
        if (model_.sites_.body) {
            acceleration = acceleration + evaluate_body(model_.slots_, uniforms_.data(), body_point(n, time));
        }
        for (int c = 0; c < 3; ++c) {
            S force{};
            for (int l = 0; l < lanes; ++l) {
                lane_of(force, l) = load<T>(&f_[at(l, static_cast<std::size_t>(c), n)]);
            }
            const S total = acceleration[c] + force * inverse_mass;
            for (int l = 0; l < lanes; ++l) {
                T* v = &v_[at(l, static_cast<std::size_t>(c), n)];
                store<T>(v, load<T>(v) + h * lane_of(total, l));
            }
        }
    }
    // Nodes without mass (the padding) stay where they are.
    for (std::size_t n = 0; n < stride_; ++n) {
        if (inverse_mass_[n] == T{}) {
            for (int l = 0; l < lanes; ++l) {
                for (std::size_t c = 0; c < 3; ++c) {
                    v_[at(l, c, n)] = T{};
                }
            }
        }
    }
}

template <class T, int K>
inline auto TotalLagrangianRun<T, K>::body_point(std::size_t n, double time) const -> BodyPoint<S> {
    BodyPoint<S> p;
    for (int c = 0; c < 3; ++c) {
        for (int l = 0; l < lanes; ++l) {
            lane_of(p.position[c], l) = load<T>(&u_[at(l, static_cast<std::size_t>(c), n)]);
            lane_of(p.velocity[c], l) = load<T>(&v_[at(l, static_cast<std::size_t>(c), n)]);
        }
        for (std::size_t q = 0; q < lane_count && n + q < model_.node_count(); ++q) {
            lane_of(p.position[c], 0)[static_cast<int>(q)] +=
                static_cast<T>(model_.node_positions_[3 * (n + q) + static_cast<std::size_t>(c)]);
        }
    }
    p.time = static_cast<T>(time);
    return p;
}

}  // namespace mphygs
