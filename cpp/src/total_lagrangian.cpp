// Rollouts of the total-Lagrangian transfer: values, tangents, adjoint, largest rates.
#include <cmath>
#include <sstream>

#include "mphygs/transfers/total_lagrangian_reverse.hpp"

namespace mphygs {

namespace {

template <class T, int K>
std::vector<Trajectory<T>> roll(const TotalLagrangian<T>& model, const Inputs<T, K>& inputs, int wanted,
                                const Schedule& schedule, const Progress& progress,
                                const std::function<std::string(const std::vector<T>&, int, double, int*)>& describe) {
    const std::size_t size = 3 * model.node_count();
    const std::size_t frames = schedule.steps.size() + 1;
    std::vector<Trajectory<T>> result(static_cast<std::size_t>(wanted) + 1);
    for (auto& r : result) {
        r.displacement.resize(frames * size);
        r.velocity.resize(frames * size);
    }
    Team::run(model.settings().threads, [&](Team& team) {
        TotalLagrangianRun<T, K> run(model, inputs, schedule, team);
        const auto keep = [&](std::size_t frame) {
            for (std::size_t l = 0; l < result.size(); ++l) {
                run.output(static_cast<int>(l), &result[l].displacement[frame * size], &result[l].velocity[frame * size]);
            }
        };
        keep(0);
        int n = 0;
        double time = schedule.start;
        for (std::size_t f = 0; f + 1 < frames; ++f) {
            for (int s = 0; s < schedule.steps[f]; ++s) {
                run.step(n++, static_cast<int>(f), time + s * schedule.dt[f], schedule.dt[f]);
            }
            time += schedule.steps[f] * schedule.dt[f];
            if (!run.finite()) {
                int part = -1;
                SimulationError error(describe(run.displacement(), static_cast<int>(f) + 1, time, &part));
                error.frame = static_cast<int>(f) + 1;
                error.part = part;
                throw error;
            }
            keep(f + 1);
            if (progress && !progress(static_cast<int>(f) + 1)) {
                throw SimulationError("interrupted");
            }
        }
    });
    return result;
}

}  // namespace

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
Trajectory<T> TotalLagrangian<T>::simulate(const Fields<T>& fields, const Schedule& schedule, const Progress& progress,
                                           const PointHook<T>* hook) const {
    check(fields, schedule);
    Inputs<T, 0> inputs;
    inputs.primal = &fields;
    inputs.hook = hook;
    const auto describe = [this](const std::vector<T>& u, int f, double t, int* p) { return describe_failure(u, 0, f, t, p); };
    return std::move(roll<T, 0>(*this, inputs, 0, schedule, progress, describe)[0]);
}

template <class T>
std::vector<Trajectory<T>> TotalLagrangian<T>::tangent(const Fields<T>& fields, const std::vector<Fields<T>>& directions,
                                                       const Schedule& schedule, const Progress& progress,
                                                       const PointHook<T>* hook) const {
    check(fields, schedule);
    for (const Fields<T>& d : directions) {
        Fields<T> a = d, b = fields;
        for (int i = 0; i < Fields<T>::count; ++i) {
            if (!a.all()[static_cast<std::size_t>(i)]->empty() &&
                a.all()[static_cast<std::size_t>(i)]->size() != b.all()[static_cast<std::size_t>(i)]->size()) {
                throw std::invalid_argument(std::string("a direction's ") + Fields<T>::names[static_cast<std::size_t>(i)] +
                                            " has another size than the value's");
            }
        }
    }
    const auto describe = [this](const std::vector<T>& u, int f, double t, int* p) { return describe_failure(u, 0, f, t, p); };
    std::vector<Trajectory<T>> result;
    std::size_t done = 0;
    const auto batch = [&]<int K>(std::integral_constant<int, K>) {
        Inputs<T, K> inputs;
        inputs.primal = &fields;
        inputs.hook = hook;
        inputs.first_direction = static_cast<int>(done);
        const std::size_t wanted = std::min<std::size_t>(K, directions.size() - done);
        for (std::size_t k = 0; k < wanted; ++k) {
            inputs.direction[k] = &directions[done + k];
        }
        auto part = roll<T, K>(*this, inputs, static_cast<int>(wanted), schedule, progress, describe);
        for (std::size_t k = result.empty() ? 0 : 1; k < part.size(); ++k) {
            result.push_back(std::move(part[k]));
        }
        done += wanted;
    };
    while (done < directions.size()) {
        if (directions.size() - done > 4) {
            batch(std::integral_constant<int, 8>{});
        } else {
            batch(std::integral_constant<int, 4>{});
        }
    }
    if (result.empty()) {
        result.push_back(simulate(fields, schedule, progress, hook));
    }
    return result;
}

template <class T>
Fields<T> TotalLagrangian<T>::adjoint(const Fields<T>& fields, const Schedule& schedule, const Trajectory<T>& bar,
                                      const Progress& progress, long* recomputed, const PointHook<T>* hook) const {
    check(fields, schedule);
    const std::size_t wanted = (schedule.steps.size() + 1) * 3 * node_count();
    if ((!bar.displacement.empty() && bar.displacement.size() != wanted) || (!bar.velocity.empty() && bar.velocity.size() != wanted)) {
        throw std::invalid_argument("the bar of the trajectory must be (frames + 1, nodes, 3)");
    }
    Fields<T> result;
    Team::run(settings_.threads, [&](Team& team) {
        TotalLagrangianReverse<T> reverse(*this, fields, schedule, bar, hook, team);
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
    // One tangent substep from rest: with a unit step, du = 0 and dv = x gives the force on v,
    // du = x gives the stiffness. No gravity, no hold: both only lower the frequencies.
    Fields<T> value = fields;
    std::fill(value.gravity.begin(), value.gravity.end(), T{});
    value.displacement0.clear();
    value.velocity0.clear();
    value.node_force.clear();
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
    template std::vector<T> TotalLagrangian<T>::node_mass(const Fields<T>&) const;                                        \
    template Trajectory<T> TotalLagrangian<T>::simulate(const Fields<T>&, const Schedule&, const Progress&, const PointHook<T>*) const; \
    template std::vector<Trajectory<T>> TotalLagrangian<T>::tangent(const Fields<T>&, const std::vector<Fields<T>>&,      \
                                                                    const Schedule&, const Progress&, const PointHook<T>*) const; \
    template Fields<T> TotalLagrangian<T>::adjoint(const Fields<T>&, const Schedule&, const Trajectory<T>&, const Progress&, long*, \
                                                   const PointHook<T>*) const; \
    template std::vector<T> TotalLagrangian<T>::rest_forces(const Fields<T>&) const;                                      \
    template std::array<double, 2> TotalLagrangian<T>::largest_rates(const Fields<T>&, int, const PointHook<T>*) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
