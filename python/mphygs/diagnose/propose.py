"""What may be missing from a model: every effect and fault, in the ways that its descriptor and the motion
suggest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.diagnose.planes import Plane, touched_planes
from mphygs.diagnose.shaking import shaking_ways
from mphygs.diagnose.trials import Trial, trials_of
from mphygs.diagnose.ways import Way, missing, smooth_ways
from mphygs.fit.experiment import Experiment
from mphygs.fit.placement import masses_of_loads
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief


def surface_motion(problem: Problem, belief: Belief, name: str) -> tuple[np.ndarray, np.ndarray]:
    """(T, S, 3) surface points over the fitted frames and (S, 3) at rest [m]."""
    predictor = problem.predictors[name]
    first, last = problem.ranges[name]
    timeline = predictor.timeline(belief, last, problem.substep or predictor.stable_substep(belief))
    displacement = np.asarray(predictor.states(belief, timeline, feedback=problem.feedback(name))[0], float)
    g = predictor.body.geometry
    area = g["surface_area"].ravel() > 0.0
    rest = g["surface_points"].reshape(-1, 3)[area]
    cell = np.repeat(g["surface_cell"], 8, axis=0)[area]
    node, value, _ = predictor.transfer.model((), np.zeros((0, 3)), belief.law).weights(rest, cell)
    shown = displacement[timeline.skipped :]
    moved = rest + np.einsum("pk,tpkc->tpc", value, shown[:, node])
    return moved, rest


def proposals(
    experiment: Experiment,
    problem: Problem,
    belief: Belief,
    evaluation: Evaluation,
    *,
    names: Sequence[str] | None = None,
) -> tuple[list[Way], list[Trial]]:
    """Ways of smooth effects and faults, to be scored by tangents, and trials of all others.

    problem: the fit, under feedback or not; evaluation: of the belief there; names: effects to consider
    (None: all).
    """
    body = next(iter(problem.predictors.values())).body
    ways = smooth_ways(
        belief, body, names=names, hung=masses_of_loads(experiment.capture, list(problem.ranges))
    )
    worst = evaluation.worst
    first, last = problem.ranges[worst]
    misfit = experiment.observations[worst].position[first:last] - evaluation.positions[worst][first:last]
    fps = experiment.capture.sequence(worst).fps
    ways += shaking_ways(belief, body.transfer, misfit, fps, first / fps, names=names)
    planes: list[Plane] = []
    meets = any(spec.of_role("offset") for spec in missing(belief, body.transfer, names))
    if meets and hasattr(problem.predictors[worst].body, "geometry"):
        moved, rest = surface_motion(problem, belief, worst)
        step = max(1, len(rest) // 1500)
        at = problem.predictors[worst].attachment.anchor
        planes = touched_planes(moved[:, ::step], rest[::step], misfit[-len(moved) :], at)
    trials = trials_of(belief, experiment.capture, body.transfer, list(problem.ranges), planes, names=names)
    return ways, trials
