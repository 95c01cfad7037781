// One direction beside the values, point after point: its tangent, and the largest rates.
#include <cmath>

#include "mphygs/total_lagrangian/holds.hpp"
#include "mphygs/total_lagrangian/hook.hpp"
#include "mphygs/total_lagrangian/rollout.hpp"

namespace mphygs {

template <class T>
std::vector<Trajectory<T>> TotalLagrangian<T>::tangent_of_one(const Fields<T>& fields, const Fields<T>& direction, int number,
                                                              const Schedule& schedule, const Progress& progress,
                                                              const PointHook<T>* hook, const Observer* observer) const {
    const std::size_t size = 3 * node_count();
    auto trajectories = room<T>(2, (schedule.steps.size() + 1) * size);
    Inputs<T, 1> inputs;
    inputs.primal = &fields;
    inputs.direction[0] = &direction;
    inputs.hook = hook;
    inputs.observer = observer;
    inputs.first_direction = number;
    Team::run(settings_.threads, [&](Team& team) {
        TotalLagrangianRun<T, 1> run(*this, inputs, schedule, team);
        const auto keep = [&](std::size_t f) {
            for (int l = 0; l < 2; ++l) {
                Trajectory<T>& t = trajectories[static_cast<std::size_t>(l)];
                run.output(l, &t.displacement[f * size], &t.velocity[f * size]);
            }
        };
        roll(run, schedule, progress, keep, [&](int f, double time) { return failure(run.displacement(), f, time); });
        for (int l = 0; l < 2; ++l) {
            trajectories[static_cast<std::size_t>(l)].reaction = run.reaction(l);
        }
    });
    return trajectories;
}

template <class T>
std::array<double, 2> TotalLagrangian<T>::largest_rates(const Fields<T>& fields, int iterations, const PointHook<T>* hook) const {
    check_body(fields);
    geometry_.actuation.check_channels(fields.channel.size(), 1);
    // One tangent substep from rest: with a unit step, du = 0 and dv = x gives the force on v,
    // du = x gives the stiffness. No gravity, no hold: both only lower the frequencies.
    Fields<T> value = fields;
    std::fill(value.gravity.begin(), value.gravity.end(), T{});
    value.displacement0.clear();
    value.velocity0.clear();
    value.node_force.clear();
    value.target.clear();
    std::array<double, 2> result{0, 0};
    Inputs<T, 1> inputs;
    inputs.primal = &value;
    Fields<T> direction;  // empty: the perturbation is put into the state
    inputs.direction[0] = &direction;
    inputs.hook = hook;
    const Schedule none;
    Team alone;
    TotalLagrangianRun<T, 1> run(*this, inputs, none, alone);
    const std::vector<T> u = run.displacement();
    const std::vector<T> v(u.size(), T{});
    run.accelerations(1e-4);  // what the effects remember at rest
    const auto history = run.history();
    const std::size_t size = u.size() / 2;
    const bool rates = sites_.rate || sites_.body || sites_.surface || sites_.point || hook;
    for (std::size_t kind = 0; kind < (rates ? 2 : 1); ++kind) {
        std::vector<T> x(size);
        unsigned state = 12345;
        for (std::size_t i = 0; i < size; ++i) {
            state = state * 1664525u + 1013904223u;
            x[i] = run.mass()[i % (size / 3)] > T{} ? static_cast<T>(state) / T(4294967296.0) - T(0.5) : T{};
        }
        for (int i = 0; i < iterations; ++i) {
            double norm = 0;
            for (const T e : x) {
                norm += static_cast<double>(e) * static_cast<double>(e);
            }
            norm = std::sqrt(norm);
            result[kind] = i == 0 ? 0.0 : norm;
            if (norm == 0) {
                break;
            }
            run.displacement() = u;
            run.velocity() = v;
            run.history() = history;
            std::vector<T>& perturbed = kind == 0 ? run.displacement() : run.velocity();
            for (std::size_t k = 0; k < size; ++k) {
                perturbed[size + k] = static_cast<T>(static_cast<double>(x[k]) / norm);
            }
            run.accelerations(1e-4);
            for (std::size_t k = 0; k < size; ++k) {
                x[k] = -run.velocity()[size + k];
            }
        }
    }
    return result;
}

#define MPHYGS_INSTANTIATE(T)                                                                                                 \
    template std::vector<Trajectory<T>> TotalLagrangian<T>::tangent_of_one(const Fields<T>&, const Fields<T>&, int,           \
                                                                           const Schedule&, const Progress&, const PointHook<T>*, \
                                                                           const Observer*) const;                            \
    template std::array<double, 2> TotalLagrangian<T>::largest_rates(const Fields<T>&, int, const PointHook<T>*) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
