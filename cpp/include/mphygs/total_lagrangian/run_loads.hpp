// What acts on the nodes of a run besides its material: effects at places, the observer, tendons, pressures and known loads.
#pragma once

#include "mphygs/total_lagrangian/run.hpp"

namespace mphygs {

template <class T, int K>
inline auto TotalLagrangianRun<T, K>::material_point(std::size_t p, double time) const -> MaterialPoint<U> {
    MaterialPoint<U> m;
    const auto& place = model_.places_[p];
    for (int c = 0; c < 3; ++c) {
        const T rest = static_cast<T>(model_.geometry_.places[3 * p + static_cast<std::size_t>(c)]);
        m.rest[c] = constant<U>(rest);
        m.position[c] = constant<U>(rest);
        for (int l = 0; l < lanes; ++l) {
            for (std::size_t a = 0; a < 27; ++a) {
                const std::size_t i = at(l, static_cast<std::size_t>(c), static_cast<std::size_t>(place.node[a]));
                lane_of(m.position[c], l) += place.value[a] * u_[i];
                lane_of(m.velocity[c], l) += place.value[a] * v_[i];
            }
        }
    }
    m.time = static_cast<T>(time);
    return m;
}

template <class T, int K>
inline auto TotalLagrangianRun<T, K>::place_parameters(std::size_t p) const -> std::vector<U> {
    const std::size_t count = static_cast<std::size_t>(model_.sites_.point_parameters);
    std::vector<U> q(count);
    for (std::size_t i = 0; i < count; ++i) {
        q[i] = inputs_.plain(&Fields<T>::place_effect, p * count + i);
    }
    return q;
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::place_forces(double time) {
    if (!model_.sites_.point) {
        return;
    }
    for (std::size_t p = 0; p < model_.places_.size(); ++p) {
        const std::vector<U> q = place_parameters(p);
        const Vec3<U> force = evaluate_point(model_.slots_, q.data(), material_point(p, time));
        const auto& place = model_.places_[p];
        for (int l = 0; l < lanes; ++l) {
            for (int c = 0; c < 3; ++c) {
                for (std::size_t a = 0; a < 27; ++a) {
                    f_[at(l, static_cast<std::size_t>(c), static_cast<std::size_t>(place.node[a]))] +=
                        place.value[a] * lane_of(force[c], l);
                }
            }
        }
    }
}

template <class T, int K>
inline auto TotalLagrangianRun<T, K>::target_basis(int n, int frame, double dt) const -> TargetBasis {
    const std::size_t f = static_cast<std::size_t>(frame);
    return {n - first_step_[f], schedule_.steps[f], dt, rule(n).at};
}

template <class T, int K>
inline bool TotalLagrangianRun<T, K>::ask(int n, int frame, double dt) {
    if (!observer_) {
        return false;
    }
    const std::size_t interval = static_cast<std::size_t>(frame);
    if (frame != aimed_) {
        aimed_ = frame;
        pulling_ = observer_->pulls(interval);
        for (int l = 0; l < lanes; ++l) {
            const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
            observer_->aim(interval, fields ? fields->target : std::vector<T>{}, aims_[l]);
        }
    }
    const auto factors = observer_->factors(target_basis(n, frame, dt));
    const std::vector<std::size_t>& read = observer_->read_carriers();
    const T stiffness = observer_->stiffness(), damping = observer_->damping();
    constexpr std::size_t quad = ObserverRows<T>::quad;
    blend_.resize(quad * read.size());
    for (int l = 0; pulling_ && l < lanes; ++l) {
        for (std::size_t k = 0; k < read.size(); ++k) {
            for (std::size_t c = 0; c < 3; ++c) {
                const std::size_t i = at(l, c, read[k]);
                blend_[quad * k + c] = stiffness * u_[i] + damping * v_[i];
            }
        }
        observer_->ask(interval, factors, aims_[l], blend_, asked_[l]);
    }
    return pulling_;
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::spread_pulls(double dt, std::vector<const T*> asked, std::vector<T*> pulled) {
    for (int l = 0; l < lanes; ++l) {
        pulled_[l].resize(3 * stride_);
        asked.insert(asked.begin() + l, asked_[l].data());
        pulled.insert(pulled.begin() + l, pulled_[l].data());
    }
    observer_->pull(*team_, static_cast<T>(dt), asked, pulled);
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::add_pulls() {
    for (int l = 0; observer_ && pulling_ && l < lanes; ++l) {
        T* to = &v_[at(l, 0, 0)];
        for (std::size_t i = 0; i < 3 * stride_; ++i) {
            to[i] += pulled_[l][i];
        }
    }
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::actuate(std::size_t interval, const double (&powers)[4], int step) {
    for (int l = 0; actuation_ && l < lanes; ++l) {
        const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
        look(*actuation_, &u_[at(l, 0, 0)], stride_, 1);
        actuation_->channels_of(&fields->channel, interval, powers);
        pose_loads(*actuation_, *fields, step);
        l == 0 ? actuation_->value() : actuation_->change();
        push(*actuation_, &f_[at(l, 0, 0)], stride_, 1);
    }
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::pose_loads(ActuationStep& loads, const Fields<T>& fields, int step) const {
    loads.poses.clear();
    const std::size_t holds = step < 0 || fields.pose.empty() ? 0 : static_cast<std::size_t>(model_.geometry_.hold_count);
    for (std::size_t i = 0; i < 12 * holds; ++i) {
        const std::size_t from = pose_at(i / 12, step) + i % 12;
        const double now = static_cast<double>(fields.pose[from]), at = rule(step).within;
        loads.poses.push_back((1.0 - at) * now + at * static_cast<double>(fields.pose[from + 12]));
    }
}

template <class T, int K>
inline void TotalLagrangianRun<T, K>::known_forces(int frame) {
    const std::size_t nodes = model_.node_count();
    for (int l = 0; l < lanes; ++l) {
        const Fields<T>* fields = l == 0 ? inputs_.primal : inputs_.direction[l - 1];
        if (!fields || fields->node_force.empty()) {
            continue;
        }
        const T* from = fields->node_force.data() + static_cast<std::size_t>(frame) * 3 * nodes;
        for (std::size_t n = 0; n < nodes; ++n) {
            for (std::size_t c = 0; c < 3; ++c) {
                f_[at(l, c, n)] += from[3 * n + c];
            }
        }
    }
}

}  // namespace mphygs
