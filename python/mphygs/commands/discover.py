"""`mphygs discover CAPTURE`: fit, compare, diagnose, extend, again, until the error is explained."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from mphygs.capture.format import load_capture
from mphygs.capture.json_values import plain
from mphygs.capture.stages import STAGES
from mphygs.capture.written import replace_file
from mphygs.commands.claim import claim, clear
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.diagnose import DOCUMENT as DIAGNOSIS
from mphygs.commands.diagnose import diagnosis_document, drift_entries, known_effects, ranking_entries
from mphygs.commands.extend import DOCUMENT
from mphygs.commands.fit import fitted
from mphygs.commands.fit_begun import RUNS
from mphygs.commands.fit_options import FitOptions, check_options
from mphygs.commands.image_stages import has_stages, run_stages
from mphygs.commands.options import CommonOptions, OptionError
from mphygs.diagnose.missing_force_document import (
    keep_missing_force,
    missing_force_text,
    unexplained,
    with_plugin_in,
)
from mphygs.diagnose.ranking import Ranking
from mphygs.extend.candidate_table import path_rows, path_text, table_text
from mphygs.extend.conclusion import Discovery
from mphygs.extend.discovery import discover_effects
from mphygs.extend.first_window import passed_on_the_way
from mphygs.extend.loop_record import LoopRecord, read_record, recorded_left_out, write_record
from mphygs.extend.step import FAULT, Step
from mphygs.extend.steps import run_at, step_at, steps_text
from mphygs.fit.countdown import duration
from mphygs.fit.experiment import Experiment
from mphygs.fit.image_capture import assembled_capture
from mphygs.fit.of_run import experiment_of
from mphygs.fit.run import Run
from mphygs.fit.spacings import screening_spacing
from mphygs.model.belief import Belief
from mphygs.simulate.settings import check_effects

PROGRAM = "mphygs discover"
# The first model's fit, kept inside the run folder.
FIRST = "first-fit"
ANSWER = ("steps", "verdict", "effects", "run", "warnings", "table", "path")


@dataclass(frozen=True, kw_only=True)
class DiscoverOptions(CommonOptions):
    """Fit, compare, diagnose, extend, until the error is explained or nothing known explains it."""

    capture: tyro.conf.Positional[Path | None] = None
    """Folder of the capture. Without it: a small one made on the spot."""
    out: Path | None = None
    """Run folder; default: runs/NAME-OF-THE-CAPTURE-discover."""
    sequences: Annotated[str | None, tyro.conf.arg(metavar="A,B")] = None
    """Sequences to fit; default: all with frames to fit."""
    effects: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Effects and faults that may be added; default: every known one."""
    frames: Annotated[str | None, tyro.conf.arg(metavar="i:j")] = None
    """Frames to fit, i to j - 1, instead of those that the capture states."""
    transfer: Literal["total-lagrangian", "mls"] = "total-lagrangian"
    """How particles and grid exchange momentum."""
    integrator: Literal["explicit", "implicit", "auto"] = "explicit"
    """Steps in time, as of fit."""
    spacing: Annotated[float | None, tyro.conf.arg(metavar="m")] = None
    """Grid spacing [m]; default: 1.7 times that of fit, for many models are tried."""
    stages: Path | None = None
    """Of a capture in pictures: run folder whose stages are used, and made where they are missing; default:
    the run folder itself."""
    seed: int = 0
    """Of every bootstrap."""
    workers: int | None = None
    """Simulations side by side; default: one a core. Changes no number."""
    resume: bool = False
    """Continue the loop in --out where it stopped."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(DiscoverOptions, discover_command, program=PROGRAM, argv=argv)


def discover_command(options: DiscoverOptions, console: Console) -> Answer:
    """Run the loop; every step is kept in the run folder as soon as it is done."""
    out = options.out or _default_folder(options)
    first = out / FIRST
    kept = _recorded(out) if options.resume else {}
    options = _with_candidates(options, kept, out)
    candidates = known_effects(options.effects)
    check_effects(options.transfer, candidates or ())
    if not options.resume:
        claim(out, inner_runs=(FIRST,), plugin=options.plugin)
    given = {f.name: getattr(options, f.name) for f in fields(options) if f.name != "effects"}
    seen = load_capture(options.capture) if options.capture is not None else None
    if not options.resume:
        check_options(FitOptions(**given))
    if seen is not None and has_stages(seen):
        given["stages"] = options.stages or out
        console.resume = f"{PROGRAM} {shlex.quote(str(options.capture))} --out {shlex.quote(str(out))}"
        run_stages(seen, options.capture, given["stages"], console)
        seen = assembled_capture(seen, given["stages"] / STAGES)
        # the loop judges by tracks: a belief between them and the pictures is no minimum of theirs
        given["without"] = "l2d"
    screening = options.spacing is None and seen is not None
    if screening:
        given["spacing"] = screening_spacing(seen)
    resume_fit = options.resume and (first / "run.json").is_file()
    first_options = FitOptions(**(given | {"out": first, "resume": resume_fit}))
    again = _again(options, out)
    # Only once the fit begins: nothing that is at fault may take an older run's results away.
    ready = None if options.resume else lambda: clear(out, ("run.json",), plugin=options.plugin)
    state, capture = fitted(first_options, console, screening=screening, again=again, ready=ready)
    console.resume = again
    if kept.get("verdict"):
        answer = {key: kept.get(key, []) for key in ANSWER} | {"missing_force": kept.get("missing_force")}
        return Answer(answer, _text(answer, state.capture))
    begun = replace(state, left_out=recorded_left_out(kept))
    experiment, belief = experiment_of(begun, workers=options.workers)
    spacing = state.settings.spacing
    done = LoopRecord.of(kept, out / DOCUMENT)
    steps = done.steps(experiment) or [step_at(experiment, belief, spacing)]
    if screening:
        steps[0] = replace(steps[0], halfway=_halfway(state))
    if not done.documents:
        done.tell(steps[0], experiment)
        _keep(out, done, experiment, options)

    def on_step(step: Step, rankings: Sequence[Ranking]) -> None:
        done.tell(step, experiment)
        if rankings and done.ranking is None:
            done.ranking = ranking_entries([step], rankings[0], experiment)
            done.drift = drift_entries(rankings[0])
        _keep(out, done, experiment, options)
        console.say("\n".join(steps_text(plain(done.documents[-1:]))))

    console.working("looking for what is missing")
    found = discover_effects(
        experiment,
        belief,
        spacing,
        seed=state.seed,
        names=candidates,
        start=steps,
        screening=screening,
        report=lambda text: console.say(f"[{duration(console.seconds)}] {text}"),
        on_step=on_step,
    )
    # Since it was told a step may have moved to a finer grid, and the last one to its minimum.
    for k, step in enumerate(found.steps):
        if step.spacing != done.states[k]["spacing"] or k == len(found.steps) - 1:
            done.tell(step, experiment, k)
    answer = write_conclusion(out, options, state, experiment, found, done, console)
    _keep(out, done, experiment, options, answer)
    return Answer(answer, _text(answer, state.capture))


def _halfway(state: Run) -> Belief | None:
    """The model of the first half of the frames, which a fit on one grid passes before all of them."""
    if any(stage.spacing != state.settings.spacing for stage in state.history):
        return None
    return passed_on_the_way(state.earlier, [stage.misfit for stage in state.history[:-2]])


def _again(options: DiscoverOptions, out: Path) -> str:
    """The command line that goes on with a loop: with the options that change what comes of it."""
    given = {"effects": options.effects, "spacing": options.spacing, "plugin": options.plugin}
    words = [f"--{name} {shlex.quote(str(value))}" for name, value in given.items() if value is not None]
    capture = [] if options.capture is None else [shlex.quote(str(options.capture))]
    return " ".join([PROGRAM, *capture, "--out", shlex.quote(str(out)), *words, "--resume"])


def _with_candidates(options: DiscoverOptions, kept: Mapping, out: Path) -> DiscoverOptions:
    """The options with the candidates that a loop began with. Raises OptionError where others are given."""
    began = kept.get("candidates", options.effects)
    if options.effects not in (None, began):
        raise OptionError(
            f"--effects: got {options.effects}, but {out} began with {began or 'every known one'}; "
            "expected the same to resume"
        )
    return replace(options, effects=began)


def _default_folder(options: DiscoverOptions) -> Path:
    name = "embedded" if options.capture is None else options.capture.resolve().name
    return RUNS / f"{name}-discover"


def _recorded(out: Path) -> dict:
    """What the loop in a folder has found so far."""
    if not (out / FIRST).is_dir():
        raise OptionError(f"--resume: {out} holds no loop; expected the --out of an earlier {PROGRAM}")
    return read_record(out / DOCUMENT)


def _keep(
    out: Path,
    done: LoopRecord,
    experiment: Experiment,
    options: DiscoverOptions,
    answer: Mapping | None = None,
) -> None:
    """Write the steps so far; with the answer when the loop is done."""
    document = done.document(experiment) | {"candidates": options.effects}
    write_record(out / DOCUMENT, plain(document | dict(answer or {})))


def write_conclusion(
    out: Path,
    options: DiscoverOptions,
    state: Run,
    experiment: Experiment,
    found: Discovery,
    done: LoopRecord,
    console: Console,
) -> dict[str, object]:
    """Write the last model as a run, the first diagnosis beside it; the JSON of the command.

    Where nothing known explains the error, no effect is concluded: the force that the first model lacks, bad
    tracks left out, is found and kept as well.
    """
    missing = None
    if found.verdict == "unknown":
        kept = [s for s in found.steps if set(s.added) <= {FAULT}][-1]
        missing = unexplained(
            experiment, kept.belief, kept.spacing, seed=state.seed, start=kept.halfway, report=console.say
        )
        missing = with_plugin_in(missing, out, state.options.get("plugin"))
    answer = {
        "steps": done.documents,
        "verdict": found.verdict,
        "effects": list(found.effects),
        "run": str(out),
        "warnings": list(found.warnings),
        "table": done.table(found.table),
        "path": path_rows(plain(done.documents)),
        "missing_force": None if missing is None else missing.document(),
    }
    given = {key: str(v) if isinstance(v, Path) else v for key, v in asdict(options).items()}
    given |= {"command": PROGRAM, "plugin": state.options.get("plugin")}
    run_at(state, out, found.steps[-1], experiment, options=given, answer=answer).save()
    keep_missing_force(missing, out, state.options.get("plugin"))
    entries, drift = done.ranking, done.drift
    if entries is None and found.rankings:
        entries = ranking_entries(found.steps, found.rankings[0], experiment)
        drift = drift_entries(found.rankings[0])
    if entries is not None:
        told = {"table": answer["table"], "path": answer["path"]}
        document = diagnosis_document(found, entries, missing, drift=drift, **told)
        replace_file(out / DIAGNOSIS, json.dumps(plain(document), indent=1) + "\n")
    return answer


def _text(answer: Mapping, capture: Path) -> str:
    lines = steps_text(plain(answer["steps"]))
    lines += [*table_text(plain(answer["table"])), *path_text(plain(answer["path"]))]
    lines += ["", f"verdict: {answer['verdict']}; effects: {', '.join(answer['effects']) or 'none'}"]
    lines += [f"warning: {line}" for line in answer["warnings"]]
    folder = shlex.quote(str(answer["run"]))
    if answer["missing_force"]:
        lines += ["", *missing_force_text(plain(answer["missing_force"]), capture, Path(answer["run"]))]
    return "\n".join([*lines, "", f"run folder: {folder}", f"next: mphygs report {folder}"])
