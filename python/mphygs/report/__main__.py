"""`mphygs report RUN`: one self-contained HTML file."""

from __future__ import annotations

import io
import json
import shlex
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from mphygs.capture.written import replace_file
from mphygs.claim import claim_file
from mphygs.command import Answer, CommonOptions, Console, plain, run
from mphygs.compare.__main__ import comparison_document
from mphygs.compare.assess import Compared
from mphygs.compare.image_errors import joined
from mphygs.compare.pictures import sequence_figure
from mphygs.diagnose.__main__ import DOCUMENT as DIAGNOSIS
from mphygs.diagnose.missing_force_document import load_samples, missing_force_text
from mphygs.extend.__main__ import DOCUMENT as STEPS
from mphygs.fit.experiment import Experiment
from mphygs.fit.of_run import chosen_names, experiment_of, pictured_of
from mphygs.fit.run import Run, load_run
from mphygs.fit.tables import parameters_of
from mphygs.model.belief import Belief
from mphygs.predict import predict_points, surface_points
from mphygs.report.motion_data import motion_document
from mphygs.report.page import Contents, page

PROGRAM = "mphygs report"


@dataclass(frozen=True, kw_only=True)
class ReportOptions(CommonOptions):
    """One self-contained HTML file with everything known of a run."""

    run: tyro.conf.Positional[Path]
    """Run folder."""
    out: Path | None = None
    """The file; default: RUN/report.html."""
    workers: int | None = None
    """Simulations side by side; default: one a core. Changes no number."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(ReportOptions, report, program=PROGRAM, argv=argv)


def report(options: ReportOptions, console: Console) -> Answer:
    """Compare, draw, and write the page; diagnosis and steps are in it when they are in the run folder."""
    state = load_run(options.run)
    parameters = parameters_of(state)
    out = options.out or state.folder / "report.html"
    claim_file(out)
    diagnosis = _optional(state.folder / DIAGNOSIS, "verdict", "ranking", "advice")
    steps = _optional(state.folder / STEPS, "steps")
    experiment, belief = experiment_of(state, workers=options.workers)
    spacing = state.settings.spacing
    wanted = chosen_names(experiment, ())
    compared = experiment.compare(belief, spacing, names=wanted, refine=True, report=console.say)
    assessment = experiment.assess(compared)
    motions, pictures = {}, {}
    told = None if diagnosis is None else diagnosis.get("missing_force")
    forces = load_samples(state.folder, wanted) if told else {}
    for number, name in enumerate(wanted):
        console.progress((number + 1) / (len(wanted) + 1), f"drawing {name}")
        known = experiment.with_release(belief, name, spacing)
        motions[name] = motion_of(experiment, known, name, state, forces.get(name))
        pictures[name] = _picture(experiment, compared[name], name)
    comparison = comparison_document(experiment, compared, assessment)
    pictured = pictured_of(state, experiment)
    if pictured is not None:
        drawn = pictured.errors(belief, names=wanted, report=console.say)
        comparison["sequences"] = joined(comparison["sequences"], drawn)
        for name in drawn:
            pictures[f"{name}, video beside prediction"] = pictured.still(belief, name)
    contents = Contents(
        run=state,
        capture=experiment.capture,
        parameters=plain(parameters),
        comparison=plain(comparison),
        pictures=pictures,
        motions=plain(motions),
        commands=commands_of(state),
        diagnosis=diagnosis,
        force=missing_force_text(told, state.capture, state.folder) if told else (),
        steps=steps,
    )
    replace_file(out, page(contents))
    return Answer({"run": str(state.folder), "report": str(out)}, f"report: {out}")


def motion_of(
    experiment: Experiment,
    belief: Belief,
    name: str,
    state: Run,
    force: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None,
) -> dict[str, object]:
    """One sequence for the viewer, over all its frames. force: see `motion_document`."""
    recording = experiment.capture.sequence(name)
    surface = surface_points(experiment.capture)
    prediction, markers = predict_points(experiment, belief, recording, surface)
    measured = np.full((recording.frames, markers, 3), np.nan)
    if recording.markers is not None:
        measured = experiment.observations[name].position
    return motion_document(
        fps=recording.fps,
        measured=measured,
        predicted=prediction.position[:, :markers],
        surface=prediction.position[:, markers:],
        surface_part=surface.part,
        normals=surface.normal,
        fit=state.ranges.get(name, (0, 0)),
        force=force,
    )


def commands_of(state: Run) -> list[str]:
    """Command lines that make this run and this page again."""
    options = dict(state.options)
    program = str(options.pop("command", "mphygs fit"))
    words = program.split()
    for key, value in options.items():
        if key in ("json", "resume", "out", "workers", "capture", "run", "effect") or value in (None, False):
            continue
        words += [f"--{key.replace('_', '-')}"] + ([] if value is True else [str(value)])
    if "effect" in options:
        words[2:2] = [str(options["run"]), *options["effect"]]
    elif options.get("capture"):
        words.insert(2, str(options["capture"]))
    words += ["--out", str(state.folder)]
    folder = shlex.quote(str(state.folder))
    lines = [shlex.join(words)]
    if (state.folder / DIAGNOSIS).is_file() and "discover" not in program:
        lines.append(f"mphygs diagnose {folder}")
    lines += [f"mphygs compare {folder}", f"mphygs report {folder}"]
    plugin = f" --plugin {shlex.quote(str(options['plugin']))}" if options.get("plugin") else ""
    return [lines[0], *(line + plugin for line in lines[1:])]


def _picture(experiment: Experiment, compared: Compared, name: str) -> bytes:
    recording = experiment.capture.sequence(name)
    figure = sequence_figure(
        compared,
        name=name,
        fps=recording.fps,
        at=recording.markers.at,
        parts=[part.name for part in experiment.capture.parts],
        labels=recording.markers.names,
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=90, metadata={"Software": None})
    return buffer.getvalue()


def _optional(path: Path, *keys: str) -> dict | None:
    """What another command left in the run folder, None where it was not run. ValueError if damaged."""
    if not path.is_file():
        return None
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: is not JSON ({error}); expected what its command wrote") from error
    for key in keys:
        if not isinstance(found, dict) or key not in found:
            raise ValueError(f"{path}: has no '{key}'; expected what its command wrote")
    return found


if __name__ == "__main__":
    sys.exit(main())
