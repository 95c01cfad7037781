// Rollouts of the total-Lagrangian transfer: values, adjoint.
#include <cmath>
#include <sstream>

#include "mphygs/total_lagrangian/midpoint_reverse.hpp"
#include "mphygs/total_lagrangian/rollout.hpp"
#include "mphygs/total_lagrangian/value_run.hpp"

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

namespace {

template <class T>
Fields<T> gradient_of(const TotalLagrangian<T>& model, const Fields<T>& fields, const Schedule& schedule, const typename TotalLagrangian<T>::Loss& loss,
                      bool keep, const Progress& progress, long* recomputed, const PointHook<T>* hook, const Observer* observer) {
    model.check(fields, schedule, observer);
    Fields<T> result;
    Team::run(model.settings().threads, [&](Team& team) {
        TotalLagrangianReverse<T> reverse(model, fields, schedule, hook, observer, team);
        result = reverse.gradient(loss, keep, progress, recomputed);
    });
    return result;
}

}  // namespace

template <class T>
Fields<T> TotalLagrangian<T>::adjoint(const Fields<T>& fields, const Schedule& schedule, const Trajectory<T>& bar,
                                      const Progress& progress, long* recomputed, const PointHook<T>* hook,
                                      const Observer* observer) const {
    return gradient_of<T>(*this, fields, schedule, [&](const Trajectory<T>&) { return bar; }, false, progress, recomputed, hook, observer);
}

template <class T>
Fields<T> TotalLagrangian<T>::gradient(const Fields<T>& fields, const Schedule& schedule, const Loss& loss, const Progress& progress,
                                       long* recomputed, const PointHook<T>* hook, const Observer* observer) const {
    return gradient_of<T>(*this, fields, schedule, loss, true, progress, recomputed, hook, observer);
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

#define MPHYGS_INSTANTIATE(T)                                                                                             \
    template SimulationError TotalLagrangian<T>::failure(const std::vector<T>&, int, double) const;                       \
    template std::vector<T> TotalLagrangian<T>::node_mass(const Fields<T>&) const;                                        \
    template Trajectory<T> TotalLagrangian<T>::simulate(const Fields<T>&, const Schedule&, const Progress&, const PointHook<T>*, \
                                                         const Observer*) const; \
    template Fields<T> TotalLagrangian<T>::adjoint(const Fields<T>&, const Schedule&, const Trajectory<T>&, const Progress&, long*, \
                                                   const PointHook<T>*, const Observer*) const; \
    template Fields<T> TotalLagrangian<T>::gradient(const Fields<T>&, const Schedule&, const Loss&, const Progress&, long*, \
                                                    const PointHook<T>*, const Observer*) const; \
    template std::vector<T> TotalLagrangian<T>::rest_forces(const Fields<T>&) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
MPHYGS_TOTAL_LAGRANGIAN_RUN(, float)
MPHYGS_TOTAL_LAGRANGIAN_RUN(, double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
