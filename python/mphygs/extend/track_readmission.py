"""Bad tracks are judged once more by the model that explains the rest: what it predicts was never bad.

The first model may be so far off that a single marker at a tip moves like no other; a track that is lost
stays off whatever the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mphygs.compare.noise import observe
from mphygs.diagnose.outliers import bad_observations
from mphygs.extend.finer_grid import ACCURACY, compared_as_step, evaluated, fitted_by_coarse_jacobians
from mphygs.extend.step import FAULT, Step
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise, still_at_minimum
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.instruments import Reading

ITERATIONS, REFITTED = 4, 1e-3


def with_tracks_readmitted(
    experiment: Experiment, step: Step, report: Callable[[str], None] | None = None
) -> Step:
    """The step fitted to all measurements, where none of those that were left out is bad beside its model.

    The experiment's observations become the whole ones then; else nothing changes.
    """
    say = report or (lambda _text: None)
    whole = {
        name: replace(
            observe(experiment.capture.sequence(name), experiment.predictor(name, step.spacing).attachment),
            sensors=known.sensors,
        )
        for name, known in experiment.observations.items()
    }
    left_out = 0
    for name, item in step.compared.items():
        known = experiment.observations[name].observed
        first, last = item.frames
        residual = np.full_like(whole[name].position, np.nan)
        residual[first:last] = whole[name].position[first:last] - item.predicted[first:last]
        residual /= whole[name].frames_of_noise[:, None, None]
        markers = experiment.capture.sequence(name).markers
        out = whole[name].observed & ~known
        left_out += int(out.sum())
        if (bad_observations(residual, markers.at, whole[name].sigma) & out).any():
            return step
    if not left_out:
        return step
    masked = dict(experiment.observations)
    experiment.observations.update(whole)
    experiment.problems.clear()
    after = _refitted(experiment, step, report)
    if after is None or not after.explained:
        experiment.observations.update(masked)
        experiment.problems.clear()
        return step
    say(f"{left_out} measurements that were left out are as predicted: used again")
    return replace(after, dropped=(*step.dropped, FAULT))


def _refitted(experiment: Experiment, step: Step, report: Callable[[str], None] | None) -> Step | None:
    """The step fitted once more, None where that cannot be simulated."""
    problem = experiment.problem(step.spacing)
    accuracy = REFITTED if step.jacobian_spacing is None else ACCURACY
    try:
        here = _as_it_is(experiment, step)
        if still_at_minimum(
            step.belief, step.solution.evaluation, here.solution.evaluation, relative_tolerance=accuracy
        ):
            return here
        if step.jacobian_spacing is not None:
            return fitted_by_coarse_jacobians(experiment, step, step.spacing, step.jacobian_spacing, report)
        solution = minimise(problem, step.belief, iterations=ITERATIONS, relative_tolerance=REFITTED)
        compared = compared_as_step(experiment, step, solution.belief)
    except SimulationError:
        return None
    return step.refitted(solution, compared, experiment.assess(compared))


def _as_it_is(experiment: Experiment, step: Step) -> Step:
    """The step beside the experiment's present measurements, its prediction and numbers as they are."""
    compared = {
        name: replace(item, observation=experiment.observations[name]) for name, item in step.compared.items()
    }
    own = step.jacobian_spacing or step.spacing
    width = len(step.belief.free)
    if all(i.tangents_of in (None, own) and i.jacobian.shape[-1] == width for i in compared.values()):
        evaluation = experiment.problem(step.spacing).evaluated(
            step.belief,
            {name: item.predicted for name, item in compared.items()},
            {name: item.jacobian for name, item in compared.items()},
            readings={
                name: tuple(Reading(one.predicted, one.jacobian) for one in item.sensors)
                for name, item in compared.items()
            },
        )
    else:
        evaluation = evaluated(experiment, step.belief, step.spacing, step.jacobian_spacing)
    solution = replace(step.solution, evaluation=evaluation)
    return step.refitted(solution, compared, experiment.assess(compared))
