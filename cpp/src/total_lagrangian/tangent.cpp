// Derivatives of rollouts of the total-Lagrangian transfer.
#include "mphygs/total_lagrangian/direction_forces.hpp"
#include "mphygs/total_lagrangian/direction_inputs.hpp"
#include "mphygs/total_lagrangian/direction_loads.hpp"
#include "mphygs/total_lagrangian/direction_midpoint.hpp"
#include "mphygs/total_lagrangian/rollout.hpp"
#include "mphygs/total_lagrangian/value_run.hpp"

namespace mphygs {

MPHYGS_TOTAL_LAGRANGIAN_RUN(extern, float)
MPHYGS_TOTAL_LAGRANGIAN_RUN(extern, double)

namespace {

// Directions of one run.
constexpr std::size_t directions_abreast = 16;

/// f with the fewest lanes that so many directions need, at most those of a register.
template <class T, class F>
auto in_lanes(std::size_t directions, const F& f) {
    constexpr int most = register_lanes<T>;
    if constexpr (most > 4) {
        if (directions <= 4) {
            return f(std::integral_constant<int, 4>{});
        }
    }
    if constexpr (most > 8) {
        if (directions <= 8) {
            return f(std::integral_constant<int, 8>{});
        }
    }
    (void)directions;
    return f(std::integral_constant<int, most>{});
}

}  // namespace

template <class T>
std::vector<Trajectory<T>> TotalLagrangian<T>::tangent(const Fields<T>& fields, const std::vector<Fields<T>>& directions,
                                                       const Schedule& schedule, const Progress& progress, const PointHook<T>* hook,
                                                       const std::vector<Added<T>>& added, const Observer* observer) const {
    check(fields, schedule, observer);
    if (!added.empty() && added.size() != directions.size()) {
        throw std::invalid_argument("added effects of another number of directions than there are");
    }
    for (const Added<T>& a : added) {
        if (!a.active.empty() && a.effect.size() != static_cast<std::size_t>(Registry::parameter_count)) {
            throw std::invalid_argument("added effects need the parameters of all effects");
        }
    }
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
    std::vector<Trajectory<T>> result;
    if (directions.empty()) {
        result.push_back(simulate(fields, schedule, progress, hook, observer));
    }
    const std::size_t size = 3 * node_count(), numbers = (schedule.steps.size() + 1) * size;
    for (std::size_t done = 0; done < directions.size();) {
        const std::size_t wanted = std::min(directions_abreast, directions.size() - done);
        std::vector<const Fields<T>*> some;
        std::vector<const Added<T>*> theirs;
        for (std::size_t k = done; k < done + wanted; ++k) {
            some.push_back(&directions[k]);
            theirs.push_back(added.empty() ? nullptr : &added[k]);
        }
        const bool alone = wanted == 1 && !schedule.implicit && (added.empty() || added[done].active.empty());
        // A single direction is quicker beside the values, point after point.
        auto part = alone ? tangent_of_one(fields, directions[done], static_cast<int>(done), schedule, progress, hook, observer) : in_lanes<T>(wanted, [&]<int L>(std::integral_constant<int, L>) {
            auto trajectories = room<T>(1 + wanted, numbers);
            Team::run(settings_.threads, [&](Team& team) {
                TotalLagrangianDirections<T, L> run(*this, fields, some, theirs, hook, observer, static_cast<int>(done), schedule, team);
                const auto keep = [&](std::size_t f) {
                    Trajectory<T>& value = trajectories[0];
                    run.value().output(0, &value.displacement[f * size], &value.velocity[f * size]);
                    for (std::size_t k = 0; k < wanted; ++k) {
                        Trajectory<T>& slope = trajectories[k + 1];
                        run.output(k, &slope.displacement[f * size], &slope.velocity[f * size]);
                    }
                };
                roll(run, schedule, progress, keep, [&](int f, double time) { return failure(run.value().displacement(), f, time); });
                trajectories[0].reaction = run.value().reaction(0);
                for (std::size_t k = 0; k < wanted; ++k) {
                    trajectories[k + 1].reaction = run.reaction(k);
                }
            });
            return trajectories;
        });
        std::move(part.begin() + (done == 0 ? 0 : 1), part.end(), std::back_inserter(result));
        done += wanted;
    }
    return result;
}

#define MPHYGS_INSTANTIATE(T)                                                                                             \
    template std::vector<Trajectory<T>> TotalLagrangian<T>::tangent(const Fields<T>&, const std::vector<Fields<T>>&,      \
                                                                    const Schedule&, const Progress&, const PointHook<T>*, \
                                                                    const std::vector<Added<T>>&, const Observer*) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
