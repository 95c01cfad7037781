"""`mphygs report RUN`: one self-contained HTML file."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import tyro

from mphygs.baselines.kinds import maker_of
from mphygs.capture.json_values import plain
from mphygs.capture.written import replace_file
from mphygs.commands.claim import claim_file
from mphygs.commands.command import Answer, run
from mphygs.commands.compare import comparison_document
from mphygs.commands.console import Console
from mphygs.commands.diagnose import DOCUMENT as DIAGNOSIS
from mphygs.commands.extend import DOCUMENT as STEPS
from mphygs.commands.options import CommonOptions
from mphygs.compare.image_errors import joined_errors
from mphygs.diagnose.missing_force_document import load_samples, missing_force_text
from mphygs.extend.document_checks import check_models, read_diagnosis, read_steps
from mphygs.fit.of_run import chosen_names, experiment_of, pictured_of
from mphygs.fit.run import Run, is_run, load_run
from mphygs.fit.tables import parameters_of
from mphygs.report.film_frames import BUDGET as FILMED
from mphygs.report.film_frames import Filmed
from mphygs.report.models import (
    SEQUENCES,
    TOTAL,
    models_of,
    motion_of,
    scene_document,
    vertices_for,
)
from mphygs.report.page import report_page
from mphygs.report.page_contents import Contents
from mphygs.report.sensor_chart import sensors_chart
from mphygs.report.skin import skin_of

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
    return run(ReportOptions, report_command, program=PROGRAM, argv=argv)


def report_command(options: ReportOptions, console: Console) -> Answer:
    """Compare, draw, and write the page; diagnosis and steps are in it when they are in the run folder."""
    state = load_run(options.run)
    parameters = parameters_of(state)
    out = options.out or state.folder / "report.html"
    claim_file(out)
    diagnosis = read_diagnosis(state.folder / DIAGNOSIS)
    before = None if diagnosis is not None else diagnosis_before(state)
    steps = read_steps(state.folder / STEPS)
    experiment, belief = experiment_of(state, workers=options.workers, make=maker_of(state))
    if steps is not None:
        check_models(state.folder / STEPS, steps.get("states", ()), experiment.capture)
    spacing = state.settings.spacing
    wanted = chosen_names(experiment, ())
    compared = experiment.compare(belief, spacing, names=wanted, refine=True, report=console.say)
    assessment = experiment.assess(compared)
    told = None if diagnosis is None else diagnosis.get("missing_force")
    forces = load_samples(state.folder, wanted) if told else {}
    shown = sorted(wanted, key=lambda name: name not in state.ranges)[:SEQUENCES]
    models = models_of(state, belief, steps)
    skin = skin_of(experiment.capture.parts, vertices_for(len(shown)))
    motions = {}
    for number, name in enumerate(shown):
        console.progress((number + 1) / (len(shown) + 1), f"drawing {name}")
        motions[name], _ = motion_of(
            experiment, models, name, state, skin, force=forces.get(name), budget=TOTAL // len(shown)
        )
    comparison = comparison_document(experiment, compared, assessment)
    pictured = pictured_of(state, experiment)
    films: dict[str, dict[str, object]] = {}
    if pictured is not None:
        seen = {name: Filmed(pictured.ranges(name)[0]) for name in pictured.names(wanted)}
        drawn = pictured.errors(
            belief, names=wanted, report=console.say, see=lambda name, one: seen[name].add(one)
        )
        comparison["sequences"] = joined_errors(comparison["sequences"], drawn)
        chosen = list(drawn)[:SEQUENCES]
        films = {
            name: seen[name].document(f"film-{k}", FILMED // len(chosen)) for k, name in enumerate(chosen)
        }
    contents = Contents(
        run=state,
        capture=experiment.capture,
        parameters=plain(parameters),
        comparison=plain(comparison),
        scene=plain(scene_document(experiment, skin, motions)),
        films=films,
        commands=commands_of(state),
        diagnosis=diagnosis,
        diagnosis_before=before,
        force=missing_force_text(told, state.capture, state.folder) if told else (),
        steps=steps,
        hidden=[name for name in wanted if name not in shown],
        sensors=sensors_chart(compared, {s.name: s.fps for s in experiment.capture.sequences}),
    )
    replace_file(out, report_page(contents))
    return Answer({"run": str(state.folder), "report": str(out)}, f"report: {out}")


def diagnosis_before(state: Run) -> dict | None:
    """Of the run that this one was extended from, beside it or where it was; None without one."""
    own, given = state.folder.resolve(), state.options.get("run")
    if not isinstance(given, str) or not given:
        return None
    for folder in (own.parent / Path(given).name, Path(given).resolve()):
        if folder != own and is_run(folder) and load_run(folder).digest == state.digest:
            return read_diagnosis(folder / DIAGNOSIS)
    return None


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
