// What a run's directions are given, put into the lanes.
#pragma once

#include "mphygs/total_lagrangian/directions.hpp"

namespace mphygs {

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::pack_points() {
    const std::size_t points = 8 * model_.rows_.size();
    const auto pack = [&](Member member, std::vector<W>& to) {
        if (!any(member)) {
            return;
        }
        for (std::size_t s = 0; s < slabs_; ++s) {
            for (std::size_t p = 0; p < points; ++p) {
                to.push_back(lanes(member, s, 8 * static_cast<std::size_t>(model_.order_[p / 8]) + p % 8));
            }
        }
    };
    pack(&Fields<T>::mu, mu_);
    pack(&Fields<T>::lambda, lambda_);
    pack(&Fields<T>::stress_volume, volume_);
    if (model_.sites_.body_volume) {
        pack(&Fields<T>::mass, mass_points_);
    }
    if (any(&Fields<T>::deformation0)) {
        for (std::size_t s = 0; s < slabs_; ++s) {
            for (std::size_t p = 0; p < points; ++p) {
                const std::size_t from = 72 * static_cast<std::size_t>(model_.order_[p / 8]) + p % 8;
                Mat3<W> m;
                for (std::size_t i = 0; i < 9; ++i) {
                    m.e[i / 3][i % 3] = lanes(&Fields<T>::deformation0, s, from + 8 * i);
                }
                f0_.push_back(m);
            }
        }
    }
    history_.assign(slabs_ * points * static_cast<std::size_t>(model_.sites_.history), W{});
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::pack_springs() {
    if (mu_.empty() && volume_.empty()) {
        return;
    }
    spring_stiffness_.assign(slabs_ * model_.springs_.size(), W{});
    const std::size_t points = 8 * model_.rows_.size();
    for (std::size_t s = 0; s < slabs_; ++s) {
        for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
            if (model_.spring_[b] < 0) {
                continue;
            }
            const std::size_t spring = static_cast<std::size_t>(model_.spring_[b]);
            const Pack<T>&volume = value_.volume_[b], &mu = value_.mu_[b];
            W sum{};
            for (std::size_t q = 0; q < 8; ++q) {
                const std::size_t p = s * points + 8 * b + q;
                sum += volume[static_cast<int>(q)] * of(mu_, p) + mu[static_cast<int>(q)] * of(volume_, p);
            }
            spring_stiffness_[s * model_.springs_.size() + spring] = model_.springs_[spring].stiffness * sum;
        }
    }
}

template <class T, int L>
inline void TotalLagrangianDirections<T, L>::prepare_mass() {
    const bool at_places = model_.sites_.mass && any(&Fields<T>::place_mass);
    if (!any(&Fields<T>::mass) && !at_places) {
        return;
    }
    for (const Fields<T>* direction : directions_) {
        shared_mass_.push_back(model_.shared_mass(*direction));
    }
    inverse_mass_.assign(slabs_ * stride_, W{});
    for (std::size_t s = 0; s < slabs_; ++s) {
        W* m = &inverse_mass_[s * stride_];
        for (std::size_t b = 0; b < model_.rows_.size(); ++b) {
            const MassTable<T>& table = model_.masses_[static_cast<std::size_t>(model_.table_[b])];
            W point[8];
            for (std::size_t q = 0; q < 8; ++q) {
                point[q] = lanes(&Fields<T>::mass, s, 8 * static_cast<std::size_t>(model_.order_[b]) + q);
            }
            for (int a = 0; a < 27; ++a) {
                for (int q = 0; q < 8; ++q) {
                    m[model_.rows_[b][static_cast<std::size_t>(a / 3)] + a % 3] += table.by_node[a][q] * point[q];
                }
            }
        }
        for (std::size_t p = 0; at_places && p < model_.places_.size(); ++p) {
            for (std::size_t a = 0; a < 27; ++a) {
                m[model_.places_[p].node[a]] += model_.places_[p].value[a] * lanes(&Fields<T>::place_mass, s, p);
            }
        }
        for (std::size_t n = 0; n < stride_; ++n) {
            m[n] = -(value_.inverse_mass_[n] * value_.inverse_mass_[n]) * m[n];
        }
    }
}

template <class T, int L>
inline auto TotalLagrangianDirections<T, L>::values_alone(const Fields<T>& fields) -> Inputs<T, 0> {
    Inputs<T, 0> inputs;
    inputs.primal = &fields;
    if (hook_) {
        // The hook is asked once a substep, for the values and all directions; the middle of an implicit step is found by
        // the values alone.
        of_values_.forward = [this](const PointState<T>& state) { return schedule_.implicit ? hook_->forward(state) : given_; };
        inputs.hook = &of_values_;
    }
    inputs.observer = observer_;
    return inputs;
}

}  // namespace mphygs
