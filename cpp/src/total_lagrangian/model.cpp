// Rollouts of the total-Lagrangian transfer: values, adjoint, largest rates.
#include <cmath>
#include <sstream>

#include "mphygs/total_lagrangian/midpoint_reverse.hpp"
#include "mphygs/total_lagrangian/rollout.hpp"

namespace mphygs {

template <class T>
std::vector<T> TotalLagrangian<T>::node_mass(const Fields<T>& fields) const {
    check_body(fields);
    Inputs<T, 0> inputs;
    inputs.primal = &fields;
    const Schedule none;
    Team alone;
    const TotalLagrangianRun<T, 0> run(*this, inputs, none, alone);
    return {run.mass().begin(), run.mass().begin() + static_cast<std::ptrdiff_t>(node_count())};
}

template <class T>
SimulationError TotalLagrangian<T>::failure(const std::vector<T>& u, int frame, double time) const {
    int part = -1;
    SimulationError error(describe_failure(u, 0, frame, time, &part));
    error.frame = frame;
    error.part = part;
    return error;
}

template <class T>
Trajectory<T> TotalLagrangian<T>::simulate(const Fields<T>& fields, const Schedule& schedule, const Progress& progress,
                                           const PointHook<T>* hook, const Observer* observer) const {
    check(fields, schedule, observer);
    Inputs<T, 0> inputs;
    inputs.primal = &fields;
    inputs.hook = hook;
    inputs.observer = observer;
    const std::size_t size = 3 * node_count();
    auto result = room<T>(1, (schedule.steps.size() + 1) * size);
    Team::run(settings_.threads, [&](Team& team) {
        TotalLagrangianRun<T, 0> run(*this, inputs, schedule, team);
        const auto keep = [&](std::size_t f) { run.output(0, &result[0].displacement[f * size], &result[0].velocity[f * size]); };
        roll(run, schedule, progress, keep, [&](int f, double time) { return failure(run.displacement(), f, time); });
        result[0].reaction = run.reaction(0);
    });
    return std::move(result[0]);
}

template <class T>
Fields<T> TotalLagrangian<T>::adjoint(const Fields<T>& fields, const Schedule& schedule, const Trajectory<T>& bar,
                                      const Progress& progress, long* recomputed, const PointHook<T>* hook,
                                      const Observer* observer) const {
    check(fields, schedule, observer);
    const std::size_t wanted = (schedule.steps.size() + 1) * 3 * node_count();
    if ((!bar.displacement.empty() && bar.displacement.size() != wanted) || (!bar.velocity.empty() && bar.velocity.size() != wanted)) {
        throw std::invalid_argument("the bar of the trajectory must be (frames + 1, nodes, 3)");
    }
    const std::size_t reacting = schedule.reaction_weight.empty() ? 0 : (schedule.steps.size() + 1) * wrench_size * static_cast<std::size_t>(geometry_.hold_count);
    if (!bar.reaction.empty() && bar.reaction.size() != reacting) {
        throw std::invalid_argument("the bar of the reactions must be (frames + 1, holds, 6), and the schedule ask for them");
    }
    Fields<T> result;
    Team::run(settings_.threads, [&](Team& team) {
        TotalLagrangianReverse<T> reverse(*this, fields, schedule, bar, hook, observer, team);
        result = reverse.gradient(progress, recomputed);
    });
    return result;
}

template <class T>
std::vector<T> TotalLagrangian<T>::rest_forces(const Fields<T>& fields) const {
    check_body(fields);
    Fields<T> value = fields;
    std::fill(value.gravity.begin(), value.gravity.end(), T{});
    value.displacement0.clear();
    value.velocity0.clear();
    value.node_force.clear();
    value.target.clear();
    value.channel.clear();
    std::fill(value.stress_volume.begin(), value.stress_volume.end(), T{});  // no stress
    Inputs<T, 0> inputs;
    inputs.primal = &value;
    const Schedule none;
    Team alone;
    TotalLagrangianRun<T, 0> run(*this, inputs, none, alone);
    run.accelerations(1.0);
    std::vector<T> force(3 * node_count());
    for (std::size_t n = 0; n < node_count(); ++n) {
        for (std::size_t c = 0; c < 3; ++c) {
            force[3 * n + c] = run.mass()[n] * run.velocity()[run.at(0, c, n)];
        }
    }
    return force;
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

#define MPHYGS_INSTANTIATE(T)                                                                                             \
    template SimulationError TotalLagrangian<T>::failure(const std::vector<T>&, int, double) const;                       \
    template std::vector<T> TotalLagrangian<T>::node_mass(const Fields<T>&) const;                                        \
    template Trajectory<T> TotalLagrangian<T>::simulate(const Fields<T>&, const Schedule&, const Progress&, const PointHook<T>*, \
                                                         const Observer*) const; \
    template Fields<T> TotalLagrangian<T>::adjoint(const Fields<T>&, const Schedule&, const Trajectory<T>&, const Progress&, long*, \
                                                   const PointHook<T>*, const Observer*) const; \
    template std::vector<T> TotalLagrangian<T>::rest_forces(const Fields<T>&) const;                                      \
    template std::array<double, 2> TotalLagrangian<T>::largest_rates(const Fields<T>&, int, const PointHook<T>*) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
