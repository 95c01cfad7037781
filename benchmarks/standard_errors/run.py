"""How far E is off in standard errors: fits of captures whose truth was simulated in different ways.

    python benchmarks/standard_errors/run.py [--simulators mls] [--seeds 0,1] [--out DIR] [--json]

Every fit is a command in a process of its own, on workers as `mphygs batch` has them. Captures and answers
are kept in the output folder; what is there already is not run again, so an interrupted benchmark goes on
where it stopped.
"""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mphygs.batch.run_on_workers import exit_code_of, run_on_workers
from mphygs.batch.work import Outcome, Task
from mphygs.synth.make import make_capture
from mphygs.synth.recipe import SIMULATORS, recipe

STANDARD_ERRORS = 2.0


@dataclass(frozen=True)
class Options:
    """Fit captures of known stiffness with default options."""

    simulators: Annotated[str, tyro.conf.arg(metavar="a,b")] = "total-lagrangian,finite-element"
    """What simulates the truths."""
    seeds: Annotated[str, tyro.conf.arg(metavar="0,1")] = "0,1"
    """Seeds of materials, marker places and noise."""
    shape: str = "two-part-bar"
    """The object."""
    markers: int = 60
    """Number of markers."""
    frames: int = 48
    """Frames of each motion."""
    out: Path = Path("runs/standard_errors")
    """Folder for captures and results."""
    workers: int = 1
    """Commands side by side on this machine."""
    threads: int | None = None
    """Of each of them; default: the cores, shared out."""
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="tcp://HOST:PORT")] = None
    """Of dask.distributed, whose workers are used."""
    json: bool = False
    """Print one JSON object on standard output, and the rest on standard error."""


def captured(simulator: str, seed: int, options: Options) -> Path:
    """The capture whose truth a simulator made, unless it is there."""
    folder = options.out / f"{options.shape}-{options.markers}-{options.frames}-{simulator}-{seed}"
    if not (folder / "answer.json").is_file():
        made = recipe(
            options.shape,
            seed=seed,
            simulator=simulator,
            frames=options.frames,
            marker_count=options.markers,
        )
        make_capture(made, folder)
    return folder


def fitted(captures: Sequence[Path], options: Options) -> None:
    """Fit all captures that are not fitted yet; the answer is kept beside each."""
    logs, place = options.out.absolute() / "logs", Path(os.getcwd())
    todo = {}
    for folder in captures:
        run = Path(f"{folder.absolute()}-run")
        words = ("fit", str(folder.absolute()), "--out", str(run))
        if not folder.with_suffix(".json").is_file():
            task = Task(folder.name, str(folder), words, run, logs, place, limited=True, resumable=True)
            todo[task] = folder

    def ended(task: Task, outcome: Outcome) -> None:
        if outcome.answer is None:
            print(f"{task.name}: {outcome.line}", file=sys.stderr, flush=True)
            return
        kept = todo[task].with_suffix(".json")
        partial = kept.with_suffix(".part")
        partial.write_text(json.dumps(outcome.answer) + "\n")
        partial.replace(kept)

    run_on_workers(list(todo), ended, options)


def told(folder: Path) -> dict[str, dict[str, float]]:
    """By part, true E, fitted E and its standard error [Pa]."""
    truth = json.loads((folder / "answer.json").read_text())
    found = json.loads(folder.with_suffix(".json").read_text())
    entries = {part: found["parameters"][f"{part}.youngs_modulus"] for part in truth["parts"]}
    return {
        part: {"true": truth["parts"][part]["E"], "value": entry["value"], "std": entry["std"]}
        for part, entry in entries.items()
    }


def table(records: Sequence[tuple[str, int, dict[str, dict[str, float]]]]) -> list[str]:
    """A line for each E, and one for each simulator."""
    lines = ["| truth | seed | part | E off by % | std % | z |", "|" + " --- |" * 6]
    scores: dict[str, list[float]] = {}
    captures: dict[str, list[bool]] = {}
    for simulator, seed, parts in records:
        own = []
        for part, entry in parts.items():
            off, std = entry["value"] - entry["true"], entry["std"]
            own.append(off / std)
            cells = f"{100.0 * off / entry['true']:.2f} | {100.0 * std / entry['value']:.2f} | {own[-1]:.2f}"
            lines.append(f"| {simulator} | {seed} | {part} | {cells} |")
        scores.setdefault(simulator, []).extend(own)
        captures.setdefault(simulator, []).append(max(map(abs, own)) <= STANDARD_ERRORS)
    for simulator, z in scores.items():
        hits = captures[simulator]
        right = f"{sum(hits)} of {len(hits)} captures within {STANDARD_ERRORS:g}"
        worth = math.sqrt(np.mean(np.square(z)))
        lines.append(f"| {simulator} | all | {right} | | | rms {worth:.2f} |")
    return lines


def main() -> int:
    """Run, print, and keep everything in the output folder."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    simulators = [name.strip() for name in options.simulators.split(",")]
    if unknown := [name for name in simulators if name not in SIMULATORS]:
        print(f"--simulators: '{unknown[0]}'; expected some of {', '.join(SIMULATORS)}", file=sys.stderr)
        return 2
    options.out.mkdir(parents=True, exist_ok=True)
    return exit_code_of(lambda: tabled(simulators, options), partial(print, file=sys.stderr))


def tabled(simulators: Sequence[str], options: Options) -> int:
    """Run all that is asked for, and tell it. Returns the exit code."""
    seeds = [int(s) for s in options.seeds.split(",")]
    captures = {(name, seed): captured(name, seed, options) for seed in seeds for name in simulators}
    fitted(list(captures.values()), options)
    done = {key: folder for key, folder in captures.items() if folder.with_suffix(".json").is_file()}
    records = [(simulator, seed, told(folder)) for (simulator, seed), folder in done.items()]
    if not records:
        return 1
    lines = table(sorted(records, key=lambda r: r[0]))
    print("\n".join(lines), file=sys.stderr if options.json else sys.stdout)
    if options.json:
        print(json.dumps([{"simulator": s, "seed": k, "parts": parts} for s, k, parts in records]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
