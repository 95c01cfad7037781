// From substeps to output frames, for a run with directions or without.
#pragma once

#include "mphygs/total_lagrangian/model.hpp"

namespace mphygs {

/// All output frames of a run. keep(frame): copies its state.
/// failure(frame, time): what is thrown where it is no longer finite.
template <class Run, class Keep, class Failure>
void roll(Run& run, const Schedule& schedule, const Progress& progress, const Keep& keep, const Failure& failure) {
    keep(0);
    int n = 0;
    double time = schedule.start;
    for (std::size_t f = 0; f < schedule.steps.size(); ++f) {
        for (int s = 0; s < schedule.steps[f]; ++s) {
            run.step(n++, static_cast<int>(f), time + s * schedule.dt[f], schedule.dt[f]);
        }
        time += schedule.steps[f] * schedule.dt[f];
        if (!run.finite()) {
            throw failure(static_cast<int>(f) + 1, time);
        }
        keep(f + 1);
        if (progress && !progress(static_cast<int>(f) + 1)) {
            throw SimulationError("interrupted");
        }
    }
}

template <class T>
std::vector<Trajectory<T>> room(std::size_t count, std::size_t numbers) {
    std::vector<Trajectory<T>> result(count);
    for (auto& r : result) {
        r.displacement.resize(numbers);
        r.velocity.resize(numbers);
    }
    return result;
}

}  // namespace mphygs
