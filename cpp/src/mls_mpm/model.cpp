// Rollouts of the MLS-MPM transfer: values, tangents, largest rates.
#include <cmath>
#include <type_traits>

#include "mphygs/mls_mpm/chunk.hpp"
#include "mphygs/mls_mpm/start.hpp"

namespace mphygs {

namespace {

template <class T, int K>
std::vector<ParticleTrajectory<T>> roll(const MlsMpm<T>& model, const Inputs<T, K>& inputs, int wanted, const Schedule& schedule,
                                        const Progress& progress) {
    const std::size_t count = model.particle_count(), frames = schedule.steps.size() + 1;
    std::vector<ParticleTrajectory<T>> result(static_cast<std::size_t>(wanted) + 1);
    for (auto& r : result) {
        r.position.resize(frames * 3 * count);
        r.velocity.resize(frames * 3 * count);
        r.deformation.resize(frames * 9 * count);
    }
    Team::run(model.settings().threads, [&](Team& team) {
        MlsMpmRun<T, K> run(model, inputs, schedule, team);
        const auto keep = [&](std::size_t frame) {
            for (std::size_t l = 0; l < result.size(); ++l) {
                run.output(static_cast<int>(l), &result[l].position[frame * 3 * count], &result[l].velocity[frame * 3 * count],
                           &result[l].deformation[frame * 9 * count]);
            }
        };
        keep(0);
        run.begin();
        for (int n = 0; n < run.table().count(); ++n) {
            run.step(n);
            if (run.table().is_frame(n + 1)) {
                const int frame = run.table().frame_of_state(n + 1);
                keep(static_cast<std::size_t>(frame));
                if (progress && !progress(frame)) {
                    throw SimulationError("interrupted");
                }
            }
        }
        for (std::size_t l = 0; l < result.size(); ++l) {
            result[l].reaction = run.reaction(static_cast<int>(l));
        }
    });
    return result;
}

}  // namespace

template <class T>
ParticleTrajectory<T> MlsMpm<T>::simulate(const Fields<T>& fields, const Schedule& schedule, const Progress& progress,
                                          const Observer* observer) const {
    check(fields, schedule, observer);
    Inputs<T, 0> inputs;
    inputs.primal = &fields;
    inputs.observer = observer;
    return std::move(roll<T, 0>(*this, inputs, 0, schedule, progress)[0]);
}

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

#define MPHYGS_INSTANTIATE(T)                                                                                                     \
    template ParticleTrajectory<T> MlsMpm<T>::simulate(const Fields<T>&, const Schedule&, const Progress&, const Observer*) const; \
    template std::vector<ParticleTrajectory<T>> MlsMpm<T>::tangent(const Fields<T>&, const std::vector<Fields<T>>&, const Schedule&, \
                                                                   const Progress&, const Observer*) const;
MPHYGS_INSTANTIATE(float)
MPHYGS_INSTANTIATE(double)
#undef MPHYGS_INSTANTIATE

}  // namespace mphygs
