"""The first steps of a refit, by derivatives that are known already but for those of the effect."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mphygs.fit.borrowed_jacobians import led_by_secants
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError


def approached_from(problem: Problem, before: Solution, start: Belief) -> Belief:
    """A start nearer to the minimum of a refit, without one Jacobian of all parameters.

    before: the fit without the effect, to the same frames: how the motion answers to its parameters has
    hardly changed at the start, and what has the secants put right. start: its belief with the effect; as it
    is where the two do not fit together, or nothing is gained. Raises SimulationError where the start cannot
    be simulated.
    """
    evaluation = _evaluated(problem, before, start)
    return start if evaluation is None else led_by_secants(problem, start, evaluation)


def _evaluated(problem: Problem, before: Solution, start: Belief) -> Evaluation | None:
    """The start's evaluation: derivatives by what is new computed there, by the rest those of before."""
    known = {p.key: (k, p) for k, p in enumerate(before.belief.free)}
    free, slope = start.free, before.evaluation.jacobian[: before.evaluation.data_rows]
    new = [p.key for p in free if p.key not in known]
    old = [k for k, p in enumerate(free) if p.key in known]
    if not new or not np.any(slope) or any(known[free[k].key][1].log != free[k].log for k in old):
        return None
    place = {p.key: k for k, p in enumerate(free)}
    positions, slopes, readings = {}, {}, {}
    for name, (_, last) in problem.ranges.items():
        prediction = problem.predictors[name].predict(start, last=last, keys=new, substep=problem.substep)
        positions[name] = prediction.position
        slopes[name] = np.zeros((*prediction.position.shape, len(free)))
        columns = [place[key] for key in new]
        slopes[name][..., columns] = prediction.jacobian
        readings[name] = tuple(reading.with_columns(columns, len(free)) for reading in prediction.readings)
    evaluation = problem.evaluated(start, positions, slopes, readings=readings)
    if len(slope) != evaluation.data_rows:
        return None  # of other frames
    jacobian = evaluation.jacobian.copy()
    jacobian[: len(slope), old] = slope[:, [known[free[k].key][0] for k in old]]
    if not np.isfinite(jacobian).all():
        raise SimulationError("the derivatives at the start are not finite")
    return replace(evaluation, slopes=jacobian)
