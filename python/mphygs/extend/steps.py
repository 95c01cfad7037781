"""Steps of the loop: made again from a belief, told as JSON, kept in a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mphygs.compare.grid_share import grid_shift
from mphygs.compare.metrics import sensors_document
from mphygs.extend.candidate_table import with_fitted_numbers
from mphygs.extend.finer_grid import compared_on_both_grids, compared_on_grid, evaluated
from mphygs.extend.step import FAULT, Step, known_budget, staying
from mphygs.fit.belief_document import belief_from_document, document_of_belief
from mphygs.fit.boundary_share import boundary_columns, widened
from mphygs.fit.determined import information_of
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, covariance
from mphygs.fit.limits import FAR, narrowed_to_seen
from mphygs.fit.of_run import compared_errors
from mphygs.fit.one_sided import coarser_change, limits_of
from mphygs.fit.place_fit import movable
from mphygs.fit.place_uncertainty import located, with_place_uncertainty
from mphygs.fit.problem import Problem
from mphygs.fit.residual_correlation import widened_by_correlation
from mphygs.fit.run import Run, StageRecord
from mphygs.fit.tables import number_text, parameter_lines
from mphygs.fit.uncertainty import grid_moves
from mphygs.model.belief import Belief


def step_at(
    experiment: Experiment,
    belief: Belief,
    spacing: float,
    *,
    added: Sequence[str] = (),
    ties: Sequence[str] = (),
    jacobian_spacing: float | None = None,
    refined: bool = False,
    refinement_spacing: float | None = None,
    stays: bool = False,
) -> Step:
    """The step that ended at a belief. jacobian_spacing, refinement_spacing: see `Step`; refined: whether the
    discretisation's share was asked for (where Jacobians are lent it always is); stays: whether a finer grid
    was seen to leave its misfit as it is."""
    evaluation = evaluated(experiment, belief, spacing, jacobian_spacing)
    if jacobian_spacing is None:
        compared = compared_on_grid(
            experiment, belief, spacing, refined=refined, refinement_spacing=refinement_spacing
        )
    else:
        compared = compared_on_both_grids(experiment, belief, spacing, jacobian_spacing)
    compared = staying(compared) if stays else compared
    solution = Solution(belief, evaluation, (evaluation.cost,), True, "kept")
    assessment = experiment.assess(compared)
    return Step(
        belief,
        solution,
        compared,
        assessment,
        spacing,
        tuple(added),
        tuple(ties),
        jacobian_spacing=jacobian_spacing,
        refinement_spacing=refinement_spacing,
    )


def state_of(step: Step) -> dict[str, object]:
    """What a loop that is resumed has to know of a step besides its document."""
    return {
        "belief": document_of_belief(step.belief),
        "spacing": step.spacing,
        "jacobian_spacing": step.jacobian_spacing,
        "refined": known_budget(step),
        "stays": step.stays,
        "persists": step.persists,
        "refinement_spacing": step.refinement_spacing,
        "moved": dict(step.moved),
        "coarse_belief": step.coarse_belief and document_of_belief(step.coarse_belief),
        "window_share": step.window_share,
        "reconciled": step.reconciled,
        "warnings": list(step.warnings),
    }


def restored(
    experiment: Experiment,
    state: Mapping[str, object],
    document: Mapping[str, object],
    before: Sequence[str] = (),
) -> Step:
    """The step of a state and its document. before: effects of the step before it."""
    coarse = state["coarse_belief"]
    step = step_at(
        experiment,
        belief_from_document(state["belief"]),
        state["spacing"],
        added=document["added"],
        ties=document["ties"],
        jacobian_spacing=state["jacobian_spacing"],
        refined=state["refined"],
        refinement_spacing=state["refinement_spacing"],
        stays=state.get("stays", False),
    )
    return replace(
        step,
        dropped=tuple(name for name in before if name not in document["effects"]),
        window_share=state["window_share"],
        reconciled=state["reconciled"],
        moved=state["moved"],
        coarse_belief=coarse and belief_from_document(coarse),
        warnings=tuple(state["warnings"]),
        persists=state.get("persists", False),
        table=tuple(document.get("table", ())),
    )


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


def step_document(step: Step, experiment: Experiment, before: Sequence[str]) -> dict[str, object]:
    """One step as JSON. before: everything that was in the model, or corrected for, before this step."""
    effects, parameters = step.belief.effects, told_parameters(step, experiment)
    # Corrections for faults that are not terms of the model are effects of the step all the same.
    kept = [name for name in before if name in effects or name == FAULT]
    inside = dict.fromkeys(name for name in (*kept, *effects, *step.added) if name not in step.dropped)
    return {
        "effects": list(inside),
        "added": list(step.added),
        "ties": list(step.ties),
        "sequences": compared_errors(experiment, step.compared),
        **({"sensors": sensors} if (sensors := sensors_document(step.compared)) else {}),
        "adequate": step.assessment.adequate,
        "p_value": step.assessment.p_value,
        "grid": step.assessment.grid if known_budget(step) else None,
        "by": step.assessment.by or ("all frames" if step.reconciled else None),
        "table": with_fitted_numbers(step.table, parameters, step.added),
        "parameters": parameters,
    }


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


def left_out_of(experiment: Experiment) -> dict[str, tuple[tuple[int, int], ...]]:
    """(frame, marker) by sequence of what was measured and is not used."""
    found = {}
    for name, observation in experiment.observations.items():
        measured = np.isfinite(experiment.capture.sequence(name).markers.position).all(2)
        dropped = np.argwhere(measured & ~np.isfinite(observation.position).all(2))
        if len(dropped):
            found[name] = tuple((int(frame), int(marker)) for frame, marker in dropped)
    return found


def run_at(
    run: Run,
    folder: Path,
    step: Step,
    experiment: Experiment,
    *,
    options: Mapping[str, object],
    answer: Mapping[str, object] | None,
) -> Run:
    """The run that ends with a step. options: of the command that made it."""
    step = bounded(step, experiment)
    spread, information, places = uncertainty(step, experiment)
    solution = step.solution
    name = f"with {', '.join(step.belief.effects)}" if step.belief.effects else "fitted on"
    record = StageRecord(
        name, step.spacing, solution.history, solution.converged, solution.reason, 0.0,
        solution.evaluation.misfit,
    )  # fmt: skip
    return replace(
        run,
        folder=folder,
        options=options,
        settings=replace(run.settings, spacing=step.spacing),
        start=run.belief,
        belief=located(step.belief, places, experiment.capture.parts),
        covariance=spread,
        information=information,
        limits=step.limits or {},
        history=(*run.history, record),
        left_out=left_out_of(experiment),
        answer=answer,
    )


def steps_text(steps: Sequence[Mapping[str, object]]) -> list[str]:
    """Lines for people: the error falling step by step, in standard deviations of the noise."""
    lines = []
    for step in steps:
        if step["added"]:
            lines.append(f"+ {', '.join(step['added'])}")
        else:
            lines.append(f"before: {', '.join(step['effects']) or 'elasticity alone'}")
        for name, ranges in step["sequences"].items():
            errors = [
                f"{label} {1e3 * error['rms']:.3f} mm ({error['rms_over_sigma']:.2f} sigma)"
                for label, error in ranges.items()
                if error is not None and label != "all"
            ]
            lines.append(f"  {name}: {', '.join(errors)}")
            lines += _sensor_lines(step.get("sensors", {}).get(name, ()))
        for key, entry in step["parameters"].items():
            if key.rsplit(".", 1)[0] in step["added"]:
                lines.append(f"  {key} = {number_text(entry)}")
            elif entry.get("bound"):
                lines.append(f"  {key}: {entry['note']}")
        if step["ties"]:
            lines.append(f"  not told apart from: {', '.join(step['ties'])}")
    return lines


def _sensor_lines(entries: Sequence[Mapping[str, object]]) -> list[str]:
    """The same of the instruments of a sequence."""
    lines = []
    for entry in entries:
        errors = [
            f"{label} {error['rms']:.3g} {entry['unit']} ({error['rms_over_sigma']:.2f} sigma)"
            for label in ("fit", "predict")
            if (error := entry[label]) is not None
        ]
        lines.append(f"    {entry['sensor']}, {entry['quantity']}: {', '.join(errors)}")
    return lines
