// Largest rates of the MLS-MPM transfer, for the length of the substep.
#include <algorithm>
#include <cmath>

#include "mphygs/mls_mpm/linearise.hpp"

namespace mphygs {

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

template std::array<double, 2> MlsMpm<float>::largest_rates(const Fields<float>&, int) const;
template std::array<double, 2> MlsMpm<double>::largest_rates(const Fields<double>&, int) const;

}  // namespace mphygs
