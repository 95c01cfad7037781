// Derivatives of rollouts of the MLS-MPM transfer, and largest rates for the length of the substep.
#include <algorithm>
#include <cmath>
#include <type_traits>

#include "mphygs/mls_mpm/linearise.hpp"
#include "mphygs/mls_mpm/rollout.hpp"

namespace mphygs {

template <class T>
std::vector<ParticleTrajectory<T>> MlsMpm<T>::tangent(const Fields<T>& fields, const std::vector<Fields<T>>& directions,
                                                      const Schedule& schedule, const Progress& progress,
                                                      const Observer* observer) const {
    check(fields, schedule, observer);
    Fields<T> value = fields;
    for (Fields<T> d : directions) {
        for (std::size_t i = 0; i < Fields<T>::count; ++i) {
            if (!d.all()[i]->empty() && d.all()[i]->size() != value.all()[i]->size()) {
                throw std::invalid_argument(std::string("a direction's ") + Fields<T>::names[i] +
                                            " has another size than the value's");
            }
        }
    }
    std::vector<ParticleTrajectory<T>> result;
    std::size_t done = 0;
    const auto batch = [&]<int K>(std::integral_constant<int, K>) {
        Inputs<T, K> inputs;
        inputs.primal = &fields;
        inputs.observer = observer;
        const std::size_t wanted = std::min<std::size_t>(K, directions.size() - done);
        for (std::size_t k = 0; k < wanted; ++k) {
            inputs.direction[k] = &directions[done + k];
        }
        auto part = roll<T, K>(*this, inputs, static_cast<int>(wanted), schedule, progress);
        for (std::size_t k = result.empty() ? 0 : 1; k < part.size(); ++k) {
            result.push_back(std::move(part[k]));
        }
        done += wanted;
    };
    while (done < directions.size()) {
        if (directions.size() - done > 1) {
            batch(std::integral_constant<int, 4>{});
        } else {
            batch(std::integral_constant<int, 1>{});
        }
    }
    if (result.empty()) {
        result.push_back(simulate(fields, schedule, progress, observer));
    }
    return result;
}

template <class T>
std::array<double, 2> MlsMpm<T>::largest_rates(const Fields<T>& fields, int iterations) const {
    // At rest, no gravity, no hold: both only lower the frequencies.
    MlsGeometry geometry = geometry_;
    geometry.hold.clear();
    geometry.hold_count = 0;
    std::fill(geometry.actuation.hold.begin(), geometry.actuation.hold.end(), -1);
    const MlsMpm<T> model(std::move(geometry), settings_);
    Fields<T> value = fields;
    std::fill(value.gravity.begin(), value.gravity.end(), T{});
    for (std::vector<T>* absent : {&value.displacement0, &value.velocity0, &value.node_force, &value.pose, &value.target}) {
        absent->clear();
    }
    Schedule schedule;
    schedule.steps = {1};
    schedule.dt = {1e-4};
    model.check(value, schedule);
    Inputs<T, 1> inputs;
    inputs.primal = &value;
    Team alone;
    MlsMpmRun<T, 1> run(model, inputs, schedule, alone);
    std::array<double, 2> result{0, 0};
    const bool damped = sites_.rate || sites_.body || sites_.surface || sites_.point;
    for (std::size_t kind = 0; kind < (damped ? 2 : 1); ++kind) {
        std::vector<T> field;
        run.linearise(field, kind == 1);  // for its size
        unsigned state = 12345;
        for (std::size_t i = 0; i < field.size(); ++i) {
            state = state * 1664525u + 1013904223u;
            field[i] = i % 4 == 3 ? T{} : static_cast<T>(state) / T(4294967296.0) - T(0.5);
        }
        for (int i = 0; i <= iterations; ++i) {
            double norm = 0;
            for (const T e : field) {
                norm += static_cast<double>(e) * static_cast<double>(e);
            }
            norm = std::sqrt(norm);
            result[kind] = i == 0 ? 0.0 : norm;
            if (norm == 0) {
                break;
            }
            for (T& e : field) {
                e = static_cast<T>(-static_cast<double>(e) / norm);
            }
            run.linearise(field, kind == 1);
        }
    }
    return result;
}

#define MPHYGS_INSTANTIATE(T)                                                                                                     \
    template std::vector<ParticleTrajectory<T>> MlsMpm<T>::tangent(const Fields<T>&, const std::vector<Fields<T>>&, const Schedule&, \
                                                                   const Progress&, const Observer*) const;                      \
    template std::array<double, 2> MlsMpm<T>::largest_rates(const Fields<T>&, int) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
