"""Steps of the loop: made again from a belief, told as JSON, kept in a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mphygs.compare.metrics import sensors_document
from mphygs.extend.candidate_table import with_fitted_numbers
from mphygs.extend.finer_grid import compared_on_both_grids, compared_on_grid, evaluated
from mphygs.extend.step import FAULT, Step, known_budget, staying
from mphygs.extend.step_uncertainty import bounded, told_parameters, uncertainty
from mphygs.fit.belief_document import belief_from_document, document_of_belief
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.of_run import compared_errors
from mphygs.fit.place_uncertainty import located
from mphygs.fit.run import Run, StageRecord
from mphygs.fit.tables import number_text
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
        "excess_beyond": step.excess_beyond,
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
        excess_beyond=state.get("excess_beyond"),
        table=tuple(document.get("table", ())),
    )


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
