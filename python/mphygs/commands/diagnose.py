"""`mphygs diagnose RUN`: which physical effect is missing, if any."""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mphygs.capture.json_values import plain
from mphygs.commands.command import Answer, run
from mphygs.commands.console import Console
from mphygs.commands.options import CommonOptions, OptionError, split_names
from mphygs.diagnose.diagnosis_document import advice, diagnosis_text, ranking_document
from mphygs.diagnose.grid_error import allowance_of
from mphygs.diagnose.missing_force_document import (
    Unexplained,
    keep_missing_force,
    missing_force_text,
    unexplained,
    with_plugin_in,
)
from mphygs.diagnose.next_motion import Proposed
from mphygs.diagnose.rank import rank
from mphygs.diagnose.ranking import Ranking
from mphygs.extend.candidate_table import path_rows, path_text, table_text
from mphygs.extend.conclusion import Discovery
from mphygs.extend.discovery import discover_effects
from mphygs.extend.loop_record import (
    LoopRecord,
    read_record,
    recorded_left_out,
    restored_ranking,
    state_of_ranking,
    write_record,
)
from mphygs.extend.separating_motions import motions_to_record
from mphygs.extend.step import FAULT, Step, excess
from mphygs.extend.steps import step_at
from mphygs.fit.experiment import Experiment
from mphygs.fit.of_run import experiment_of
from mphygs.fit.run import load_run
from mphygs.fit.spacings import default_spacing, screening_spacing
from mphygs.fit.tables import parameters_of
from mphygs.model.registry import effects
from mphygs.simulate.settings import check_effects

PROGRAM = "mphygs diagnose"
DOCUMENT = "diagnosis.json"
# What a diagnosis has found so far, in the run folder while it goes on.
SO_FAR = "diagnosis-so-far.json"


@dataclass(frozen=True, kw_only=True)
class DiagnoseOptions(CommonOptions):
    """Which physical effect, or fault of the measurement, is missing from a fitted model, if any."""

    run: tyro.conf.Positional[Path]
    """Run folder."""
    effects: Annotated[str | None, tyro.conf.arg(metavar="a,b")] = None
    """Candidates; default: every known effect and fault."""
    force: bool = False
    """Find the missing force also where named effects explain the misfit."""
    workers: int | None = None
    """Simulations side by side; default: one a core. Changes no number."""
    resume: bool = False
    """Go on with the diagnosis of RUN where it was stopped."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit code."""
    return run(DiagnoseOptions, diagnose_command, program=PROGRAM, argv=argv)


def known_effects(text: str | None) -> tuple[str, ...] | None:
    """Effects of a comma-separated list, None for none given. Raises OptionError for an unknown one."""
    wanted = split_names(text)
    for name in wanted:
        if name not in effects():
            known = ", ".join(sorted(effects()))
            raise OptionError(f"unknown effect '{name}'; expected some of {known}")
        if effects()[name].carries_gravity:
            raise OptionError(
                f"--effects: {name} is not scored; expected others, or mphygs extend RUN {name}"
            )
    return wanted or None


def diagnose_command(options: DiagnoseOptions, console: Console) -> Answer:
    """Score every candidate, refit with the best of them, judge on unseen frames; RUN stays as it is."""
    state = load_run(options.run)
    parameters_of(state)  # complete, or an error
    candidates = known_effects(options.effects)
    for name in candidates or ():
        if name in (*state.belief.effects, state.belief.law):
            raise OptionError(f"--effects: '{name}' is in the model already; expected another one")
    check_effects(state.transfer, candidates or ())
    so_far = state.folder / SO_FAR
    kept = _so_far(so_far, options) if options.resume else {}
    experiment, belief = experiment_of(
        replace(state, left_out=recorded_left_out(kept) or state.left_out), workers=options.workers
    )
    spacing = state.settings.spacing
    # Many models are tried on a coarser grid, unless the run stands on one of the user's choice.
    usual = abs(spacing / default_spacing(experiment.capture) - 1.0) < 0.1
    trying = screening_spacing(experiment.capture) if usual else spacing
    done, earlier = LoopRecord.of(kept, so_far), [restored_ranking(told) for told in kept.get("rankings", [])]
    steps = done.steps(experiment) or [step_at(experiment, belief, spacing)]

    def keep(rankings: Sequence[Ranking]) -> None:
        told = [state_of_ranking(ranking) for ranking in (*earlier, *rankings)]
        document = done.document(experiment) | {"candidates": options.effects, "rankings": told}
        write_record(so_far, plain(document))

    def on_step(step: Step, rankings: Sequence[Ranking]) -> None:
        done.tell(step, experiment)
        if rankings and done.ranking is None:
            done.ranking = ranking_entries([step], rankings[0], experiment)
            done.drift = drift_entries(rankings[0])
        keep(rankings)

    if not done.documents:
        done.tell(steps[0], experiment, before=(FAULT,) if state.left_out else ())
        keep(())
    console.resume = _again(options)
    console.working("looking for what is missing")
    found = discover_effects(
        experiment,
        belief,
        trying,
        seed=state.seed,
        names=candidates,
        start=steps,
        screening=usual,
        final=False,
        report=console.say,
        on_step=on_step,
    )
    found = replace(found, rankings=(*earlier, *found.rankings))
    entries = done.ranking
    drift = done.drift
    if entries is None:
        if found.rankings:
            ranking = found.rankings[0]
        else:
            # The observations may be others than those of the first step: bad tracks are left out of them.
            last = found.steps[-1]
            last = steps[0] if last is steps[0] else step_at(experiment, last.belief, spacing)
            ranking = _ranking(experiment, last, spacing, state.seed, candidates, console)
        entries, drift = ranking_entries(found.steps, ranking, experiment), drift_entries(ranking)
    missing = None
    if found.verdict == "unknown" or (options.force and found.verdict != "adequate"):
        missing = unexplained(experiment, belief, spacing, seed=state.seed, report=console.say)
    missing = with_plugin_in(missing, state.folder, state.options.get("plugin"))
    keep_missing_force(missing, state.folder, state.options.get("plugin"))
    motions = motions_to_record(found, experiment, trying, report=console.say)
    path = path_rows(plain(done.documents))
    table = done.table(found.table)
    document = diagnosis_document(found, entries, missing, motions, drift=drift, table=table, path=path)
    (state.folder / DOCUMENT).write_text(json.dumps(plain(document), indent=1) + "\n")
    so_far.unlink()
    lines = diagnosis_text(plain(document))
    lines += [*table_text(plain(document["table"])), *path_text(path)]
    if missing is not None:
        lines += ["", *missing_force_text(document["missing_force"], state.capture, state.folder)]
    return Answer(document, "\n".join(lines))


def _so_far(path: Path, options: DiagnoseOptions) -> dict:
    """What the diagnosis that was stopped had found. Raises OptionError where there is none like it."""
    kept = read_record(path)
    if not kept:
        raise OptionError(f"--resume: {path.parent} has no diagnosis that was stopped; expected one")
    if kept.get("candidates") != options.effects:
        raise OptionError(
            f"--effects: got {options.effects or 'every known one'}, but the diagnosis of {path.parent} "
            f"began with {kept.get('candidates') or 'every known one'}; expected the same to resume"
        )
    return kept


def _again(options: DiagnoseOptions) -> str:
    """The command line that goes on with a diagnosis."""
    words = [PROGRAM, shlex.quote(str(options.run))]
    if options.effects is not None:
        words += ["--effects", shlex.quote(options.effects)]
    return " ".join([*words, *(["--force"] if options.force else []), "--resume"])


def _ranking(
    experiment: Experiment,
    step: Step,
    spacing: float,
    seed: int,
    candidates: Sequence[str] | None,
    console: Console,
) -> Ranking:
    """The scores beside a model that needs nothing: how little would have been seen."""
    evaluation = step.solution.evaluation
    return rank(
        experiment,
        step.belief,
        evaluation,
        spacing,
        generator=np.random.default_rng((seed, 0)),
        names=candidates,
        allowance=allowance_of(experiment, spacing, step.belief, evaluation),
        report=console.say,
    )


def ranking_entries(
    steps: Sequence[Step], ranking: Ranking, experiment: Experiment
) -> list[dict[str, object]]:
    """A ranking's candidates as JSON, those first that were refitted for the first of the steps."""
    sigma = float(np.sqrt(np.mean([o.sigma**2 for o in experiment.observations.values()])))
    first = next((step for step in steps if step.refits), None)
    refitted, ties = {}, {}
    if first is not None:
        best = first.added[0]
        order = sorted(first.refits, key=lambda r: (r.entry.effect != best, excess(r.assessment)))
        refitted = {r.entry.effect: float(r.actual_drop) for r in order}
        ties = {best: first.ties}
    return ranking_document(ranking, sigma, refitted=refitted, ties=ties)


def drift_entries(ranking: Ranking) -> list[dict[str, object]]:
    """Fitted parameters that would have to change for a while where nothing else does, as JSON."""
    return [spot.document() for spot in ranking.drift]


def diagnosis_document(
    found: Discovery,
    entries: Sequence[Mapping[str, object]],
    missing: Unexplained | None = None,
    motions: Sequence[Proposed] = (),
    *,
    drift: Sequence[Mapping[str, object]] = (),
    table: Sequence[Mapping[str, object]] = (),
    path: Sequence[Mapping[str, object]] = (),
) -> dict[str, object]:
    """The JSON of a diagnosis. entries: see `ranking_entries`; motions: that would tell the first effect from
    its rival; drift: see `drift_entries`; table: see `LoopRecord.table`; path: see `path_rows`."""
    return {
        "verdict": found.verdict,
        "effects": list(found.effects),
        "ranking": list(entries),
        "missing_force": None if missing is None else missing.document(),
        "drift": list(drift),
        "table": list(table),
        "path": list(path),
        "advice": advice(found.verdict, found.effects, entries, found.warnings, motions=motions),
    }
