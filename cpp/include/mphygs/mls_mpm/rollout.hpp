// From substeps to output frames, for a run with directions or without.
#pragma once

#include "mphygs/mls_mpm/chunk.hpp"
#include "mphygs/mls_mpm/start.hpp"

namespace mphygs {

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

}  // namespace mphygs
