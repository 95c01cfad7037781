"""`mphygs compare RUN`: prediction beside measurement."""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from matplotlib.figure import Figure

from mphygs.baselines.kinds import maker_of
from mphygs.capture.format import Capture
from mphygs.capture.json_values import plain
from mphygs.capture.written import replace_file
from mphygs.commands.claim import PICTURES, claim_output, folder_inside
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, check_gain, split_names
from mphygs.compare.assess import Assessment, Compared, in_words
from mphygs.compare.image_errors import image_table, joined_errors
from mphygs.compare.metrics import sensors_document
from mphygs.compare.roughness import doubted_sigma
from mphygs.compare.sensor_pictures import sensor_figure
from mphygs.compare.sensor_residuals import sensor_lines
from mphygs.compare.sequence_pictures import save_figure, sequence_figure
from mphygs.fit.experiment import Experiment
from mphygs.fit.of_run import chosen_names, compared_errors, experiment_of, feedback_document, pictured_of
from mphygs.fit.run import load_run
from mphygs.fit.tables import errors_text, feedback_lines, parameters_of, text_table

PROGRAM = "mphygs compare"
DOCUMENT = "comparison.json"
# Lines of the text for people; the JSON has them all.
SHOWN = 5


@dataclass(frozen=True, kw_only=True)
class CompareOptions(CommonOptions):
    """Prediction beside measurement: how far, where, when, and whether more than noise."""

    run: tyro.conf.Positional[Path]
    """Run folder."""
    capture: Path | None = None
    """Another capture of the same object; default: the one that was fitted."""
    sequences: Annotated[str | None, tyro.conf.arg(metavar="A,B")] = None
    """Sequences to compare; default: all with frames to fit or to predict."""
    feedback: Annotated[float | None, tyro.conf.arg(metavar="[GAIN]")] = None
    """Also the error of the model under feedback from the measurement, which keeps it beside it: what is
    missing shows where it acts and does not pile up. Gain from 0 to 1, without a number 1: a memory of two
    frames."""
    out: Path | None = None
    """Folder for the pictures; default: RUN/pictures."""
    workers: int | None = None
    """Simulations side by side; default: one a core. Changes no number."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(CompareOptions, compare_command, program=PROGRAM, argv=argv)


@dataclass(frozen=True, eq=False)
class ComparedRun:
    """Predictions held against their measurements. document: the JSON of it; compared: by sequence."""

    document: dict[str, object]
    experiment: Experiment
    compared: Mapping[str, Compared]


def compare_command(options: CompareOptions, console: Console) -> Answer:
    """What was found, as an answer."""
    document = compared_run(options, console).document
    return Answer(document, _text(document))


def compared_run(options: CompareOptions, console: Console) -> ComparedRun:
    """Predict, hold against the measurement, draw; the finding is kept in the run folder."""
    check_gain(options.feedback)
    state = load_run(options.run)
    parameters_of(state)  # complete, or an error
    experiment, belief = experiment_of(
        state, workers=options.workers, other=options.capture, make=maker_of(state)
    )
    wanted = chosen_names(experiment, split_names(options.sequences))
    if options.out is not None:
        claim_output(options.out)
    folder = options.out or folder_inside(state.folder, PICTURES)
    count, begun = len(experiment.compared_names(wanted)), itertools.count()

    def predicting(text: str) -> None:
        console.progress(next(begun) / count, text)

    compared = experiment.compare(
        belief, state.settings.spacing, names=wanted, refine=True, report=predicting
    )
    assessment = experiment.assess(compared)
    document = comparison_document(experiment, compared, assessment)
    pictures = draw(experiment, compared, folder)
    pictured = pictured_of(state, experiment, other=options.capture)
    if pictured is not None:
        drawn = pictured.errors(belief, names=wanted, films=folder, report=console.say)
        document["sequences"] = joined_errors(document["sequences"], drawn)
        document["films"] = [str(folder / f"{name}.mp4") for name in drawn]
    document["pictures"] = [str(path) for path in pictures]
    if options.feedback is not None:
        document["feedback"] = feedback_document(
            experiment, belief, state.settings.spacing, options.feedback, names=wanted
        )
    document["warnings"] = doubted_sigma(compared)
    if options.capture is None and options.sequences is None:
        replace_file(state.folder / DOCUMENT, json.dumps(plain(document), indent=1) + "\n")
    return ComparedRun(document, experiment, compared)


def comparison_document(
    experiment: Experiment, compared: Mapping[str, Compared], assessment: Assessment
) -> dict[str, object]:
    """The JSON of a comparison."""
    sensors = sensors_document(compared)
    return {
        "sequences": compared_errors(experiment, compared),
        **({"sensors": sensors} if sensors else {}),
        "adequate": assessment.adequate,
        "p_value": assessment.p_value,
        "where": assessment.where,
        "when": assessment.when,
        "budget": assessment.budget,
    }


def draw(experiment: Experiment, compared: Mapping[str, Compared], folder: Path) -> list[Path]:
    """One picture per sequence, and one of its instruments."""
    paths = []
    for name, item in compared.items():
        paths.append(folder / f"{name}.png")
        save_figure(comparison_figure(experiment.capture, name, item), paths[-1])
        if item.sensors:
            paths.append(folder / f"{name}-sensors.png")
            fps = experiment.capture.sequence(name).fps
            save_figure(sensor_figure(item, name=name, fps=fps), paths[-1])
    return paths


def comparison_figure(capture: Capture, name: str, compared: Compared) -> Figure:
    """The picture of one sequence of a capture."""
    recording = capture.sequence(name)
    return sequence_figure(
        compared,
        name=name,
        fps=recording.fps,
        at=recording.markers.at,
        parts=[part.name for part in capture.parts],
        labels=recording.markers.names,
    )


def _text(document: Mapping[str, object]) -> str:
    lines: list[str] = [errors_text(document["sequences"]), ""]
    if document.get("sensors"):
        lines += [text_table(sensor_lines(document["sensors"])), ""]
    if document.get("films"):
        lines += [text_table(image_table(document["sequences"])), ""]
    if document.get("feedback"):
        lines += feedback_lines(document["feedback"])
    p_value = document["p_value"]
    verdict = in_words(document["adequate"], p_value)
    lines.append(f"The misfit is {verdict} (p = {p_value:.2g}, the discretisation's share allowed for).")
    budget = document["budget"]
    shares = ", ".join(f"{name} {1e3 * share:.3f} mm" for name, share in budget.items())
    lines.append(f"Shares of it, adding in squares: {shares}.")
    lines += [f"warning: {text}" for text in document["warnings"]]
    if document["where"]:
        rows = [["part", "centre mm", "rms mm beyond noise"]]
        for entry in document["where"][:SHOWN]:
            center = ", ".join(f"{1e3 * x:.1f}" for x in entry["center"])
            rows.append([entry["part"], center, f"{1e3 * entry['rms']:.3f}"])
        lines += ["", text_table(rows)]
    if document["when"]:
        rows = [["sequence", "frames", "rms mm beyond noise"]]
        for entry in document["when"][:SHOWN]:
            first, last = entry["frames"]
            rows.append([entry["sequence"], f"{first} to {last}", f"{1e3 * entry['rms']:.3f}"])
        lines += ["", text_table(rows)]
    lines += ["", *(f"picture: {path}" for path in document["pictures"])]
    lines += [f"video beside prediction: {path}" for path in document.get("films", ())]
    return "\n".join(lines)
