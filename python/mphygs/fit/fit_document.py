"""What a finished fit is told as: JSON, and text for people."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping

from mphygs.capture.format import Capture
from mphygs.compare.image_errors import image_table, joined_errors
from mphygs.compare.metrics import sensors_document
from mphygs.compare.noise import noise_document, noise_lines
from mphygs.compare.sensor_residuals import sensor_lines
from mphygs.fit.experiment import Experiment
from mphygs.fit.first_frames import starts_document
from mphygs.fit.of_run import HOMOGENEOUS, baseline_of, compared_errors, pictured_of
from mphygs.fit.profile import Interval
from mphygs.fit.run import Run
from mphygs.fit.sensitivity import WHY, sensitivity_lines
from mphygs.fit.tables import errors_text, feedback_lines, parameters_of, parameters_text, text_table
from mphygs.model.substances import like
from mphygs.scene.particles import chosen_shape
from mphygs.simulate.settings import EXPLICIT, IMPLICIT


def fit_document(
    state: Run,
    experiment: Experiment,
    found: Mapping[str, Interval],
    *,
    stages: Mapping[str, float] | None = None,
    report: Callable[[str], None] | None = None,
) -> dict[str, object]:
    """The JSON of a finished fit. found: intervals from the likelihood, by parameter; stages: seconds that
    each stage of a capture in pictures took, None of one in tracks."""
    spacing = state.settings.spacing
    compared = experiment.compare(state.belief, spacing, jacobian=False, report=report)
    errors = compared_errors(experiment, compared)
    pictured = pictured_of(state, experiment)
    drawn = {} if pictured is None else pictured.errors(state.belief, report=report)
    if drawn:
        errors = joined_errors(errors, drawn)
    predictors = {name: experiment.predictor(name, spacing) for name in state.ranges}
    substep = {name: p.stable_substep(state.belief) for name, p in predictors.items()}
    problem = experiment.problem(spacing)
    more = {} if stages is None else {"stages": dict(stages)}
    if starts := starts_document(experiment.capture, state.belief):
        more["starts"] = starts
    if sensors := sensors_document(compared):
        more["sensors"] = sensors
    if (name := baseline_of(state)) is not None:
        more["baseline"] = name
    if shapes := shapes_document(experiment.capture, spacing):
        more["shapes"] = shapes
    parameters = parameters_of(state, found)
    return more | {
        "run": str(state.folder),
        "parameters": parameters,
        "like": {
            key: like(entry["value"])
            for key, entry in parameters.items()
            if key.endswith(".youngs_modulus") and entry["determined"]
        },
        "seconds": sum(stage.seconds for stage in state.history),
        "substeps": problem.evaluate(state.belief, jacobian=False).substeps,
        "substep": substep,
        "spacing": spacing,
        "transfer": state.transfer,
        "integrator": {
            name: IMPLICIT if p.implicit(state.belief) else EXPLICIT for name, p in predictors.items()
        },
        "noise": noise_document(experiment.observations),
        "sequences": {
            name: {label: ranges[label] for label in ("fit", "predict")} for name, ranges in errors.items()
        },
    }


def shapes_document(capture: Capture, spacing: float) -> dict[str, dict[str, str]]:
    """What parts that are not said to be solids are simulated as on a grid, and why."""
    chosen = {p.name: chosen_shape(p, spacing) for p in capture.parts if p.shape != "solid"}
    return {name: {"as": shape, "why": why} for name, (shape, why) in chosen.items()}


def _boundary_lines(capture: Capture) -> list[str]:
    """What pictures say of materials, where they leave the parts' boundaries unsure."""
    unsure = max(part.boundary for part in capture.parts)
    if unsure == 0:
        return []
    return [
        f"boundaries of parts are known to {1e3 * unsure:.2g} mm and better, which the standard errors have: "
        "of thin parts E times the third power of the thickness is known better",
    ]


def fit_text(state: Run, capture: Capture, *, embedded: bool) -> str:
    """The same for people, and what to run next. embedded: whether the capture was made on the spot."""
    answer = state.answer
    lines = [parameters_text(answer["parameters"]), "", errors_text(answer["sequences"]), ""]
    if answer.get("sensors"):
        lines += [text_table(sensor_lines(answer["sensors"])), ""]
    lines[-1:] = [*noise_lines(answer.get("noise", {})), ""]
    if answer.get("feedback"):
        lines += feedback_lines(answer["feedback"])
    if answer.get("like"):
        told = [f"{key.rsplit('.', 1)[0]} {words}" for key, words in answer["like"].items()]
        lines[1:1] = ["by its stiffness: " + ", ".join(told)]
    if answer.get("shapes"):
        lines += [f"{name}: a {told['as']}, {told['why']}" for name, told in answer["shapes"].items()] + [""]
    if answer.get("sensitivity"):
        lines += [WHY, text_table(sensitivity_lines(answer["sensitivity"], answer["parameters"])), ""]
    if state.stages is not None:
        lines[-1:] = ["", text_table(image_table(answer["sequences"])), ""]
        lines[1:1] = _boundary_lines(capture)
    kinds = answer.get("integrator", {})
    steps = ", ".join(
        f"{1e6 * dt:.0f} us{', implicit,' if kinds.get(name) == IMPLICIT else ''} on {name}"
        for name, dt in answer["substep"].items()
    )
    lines.append(
        f"{answer['seconds']:.1f} s; {answer['substeps']} substeps in one pass over these frames ({steps})"
    )
    folder = shlex.quote(str(state.folder))
    if state.options.get("plugin"):
        folder += f" --plugin {shlex.quote(str(state.options['plugin']))}"
    following = [(f"compare {folder}", "where and when it fails, and whether that is more than noise")]
    if baseline_of(state) in (None, HOMOGENEOUS):
        following.append((f"diagnose {folder}", "which physical effect is missing"))
    if embedded:
        following.append((f"extend {folder} viscosity", "add that effect and see the error fall"))
    following.append((f"report {folder}", "all of it as one page"))
    wide = max(len(line) for line, _ in following)
    lines += ["", "next:", *(f"  mphygs {line:{wide}}    {words}" for line, words in following)]
    return "\n".join(lines)
