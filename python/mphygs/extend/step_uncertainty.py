"""How sure the numbers of a step are, and how far they can be moved, as every command tells them."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mphygs.compare.grid_share import grid_shift
from mphygs.extend.step import Step, known_budget
from mphygs.fit.boundary_share import boundary_columns, widened
from mphygs.fit.determined import information_of
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.limits import FAR, narrowed_to_seen
from mphygs.fit.one_sided import coarser_change, limits_of
from mphygs.fit.place_fit import movable
from mphygs.fit.place_uncertainty import located, with_place_uncertainty
from mphygs.fit.problem import Problem
from mphygs.fit.residual_correlation import widened_by_correlation
from mphygs.fit.tables import parameter_lines
from mphygs.fit.uncertainty import grid_moves


class Uncertainty(NamedTuple):
    """covariance: of the free coordinates, information: of the measurements, (P, P) each; places: standard
    deviations (3,) of where effects sit, by name [m]."""

    covariance: np.ndarray
    information: np.ndarray
    places: dict[str, np.ndarray]


def uncertainty(step: Step, experiment: Experiment) -> Uncertainty:
    """How sure a step is: by the noise, what of it lasts or is shared by markers, places that were fitted and
    boundaries that pictures leave unsure, and in the covariance by the grid as well: by how far its numbers
    came from a coarser one, and by what a refinement of its prediction would move where one is known,
    whichever is more; where neither is known, by what a coarser grid changes, if that was asked (see
    `bounded`). Of numbers that are known to show on one side alone it knows nothing.

    What a model that misses something leaves bends its numbers as well: there all of the misfit counts as
    noise, and even that says too little, for it goes on from frame to frame.
    """
    evaluation = step.solution.evaluation
    noise = covariance(evaluation)
    information = information_of(evaluation, len(step.belief.free))
    grid = experiment.problem(
        step.spacing if step.jacobian_spacing is None else step.jacobian_spacing
    )  # that of the Jacobian
    change = _grid_change(step, grid) if movable(step.belief) else None
    known = with_place_uncertainty(grid, step.belief, evaluation, noise, information, change)
    columns = boundary_columns(experiment.capture.parts, step.belief.free)
    spread, information = widened(known.covariance, known.information, columns)
    spread = spread + widened_by_correlation(grid, evaluation, noise)
    if not step.explained:
        spread = spread + noise * (max(evaluation.misfit, 1.0) ** 2 - 1.0)
    shift = known.shift
    if not known.std:
        rows = evaluation.jacobian[evaluation.data_rows :]
        shift = grid_shift(step.compared, rows.T @ rows)
    shift = _larger(shift, np.array([step.moved.get(p.key, 0.0) for p in step.belief.free]))
    spread = spread + np.outer(shift, shift)
    if step.change is not None and not shift.any():
        # Nothing else tells of the grid.
        moved = grid_moves(grid, evaluation, step.change, noise)
        spread = spread + moved @ moved.T
    information, spread = narrowed_to_seen(step.belief.free, information, spread, step.limits or {})
    return Uncertainty(spread, information, known.std)


def bounded(step: Step, experiment: Experiment) -> Step:
    """The step that knows how far its numbers can be moved (see `limits_of`), and what a coarser grid changes
    in its prediction."""
    if step.limits is not None:
        return step
    belief, evaluation = step.belief, step.solution.evaluation
    if evaluation.misfit > FAR:
        return replace(step, limits={})
    change = coarser_change(experiment, belief, evaluation, step.spacing)
    limits = limits_of(experiment.problem(step.spacing), belief, evaluation, change)
    return replace(step, limits=limits, change=change)


def told_parameters(step: Step, experiment: Experiment) -> dict[str, dict[str, object]]:
    """The numbers of a step as every command tells them."""
    step = bounded(step, experiment)
    spread, information, places = uncertainty(step, experiment)
    belief = located(step.belief, places, experiment.capture.parts)
    misfit = step.solution.evaluation.misfit
    return parameter_lines(belief, information, spread, misfit, step.limits or {})


def _larger(one: np.ndarray | None, other: np.ndarray) -> np.ndarray:
    """Whichever of two shifts of the coordinates, (P,), is larger, coordinate by coordinate."""
    return other if one is None else np.where(np.abs(one) > np.abs(other), one, other)


def _grid_change(step: Step, grid: Problem) -> np.ndarray | None:
    """(N,) what a refinement changes in the rows of the fitted frames, None where none is known."""
    if not known_budget(step):
        return None
    pieces = []
    for name, (first, last) in grid.ranges.items():
        whitener = grid.observations[name].whitener(first, last)
        pieces.append(whitener.whiten(np.nan_to_num(step.compared[name].refinement[first:last])))
    for name, (first, last) in grid.ranges.items():
        for one in step.compared[name].sensors:
            moved = np.nan_to_num(one.refinement[first:last])
            pieces.append(one.sensed.whitener(first, last).whiten(moved))
    return np.concatenate(pieces)


def undetermined(step: Step, experiment: Experiment) -> tuple[str, ...]:
    """The effects of a step's model of which the data determine no number, nor bound one: how hard a stop
    is may not show, that it is there does."""
    step = bounded(step, experiment)
    told, limits = told_parameters(step, experiment), step.limits or {}
    known = {
        p.key: told[p.key]["determined"] or p.key in limits and limits[p.key].there for p in step.belief.free
    }
    found = []
    for name in step.belief.effects:
        own = [sure for key, sure in known.items() if key.startswith(f"{name}.")]
        if own and not any(own):
            found.append(name)
    return tuple(found)
