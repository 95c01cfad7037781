"""Captures in which nothing is hidden, with noise of every kind: what `mphygs discover` makes of them.

    python benchmarks/nulls/run.py [--kinds white,heavy] [--seeds 0,1] [--out DIR] [--json]

Nothing may be named, no formula told, and E be within two standard errors. Every run is a command in a
process of its own, on workers as `mphygs batch` has them. Captures and results are kept in the output folder;
what is there already is not run again, so an interrupted benchmark goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mphygs.batch.run_on_workers import exit_code_of, run_on_workers
from mphygs.batch.work import Outcome, Task
from mphygs.capture.json_values import plain
from mphygs.model.registry import effects
from mphygs.synth.make import make_capture
from mphygs.synth.marker_noise import NOISES, Noise
from mphygs.synth.recipe import recipe

STANDARD_ERRORS = 2.0
COLUMNS = (
    "noise", "of", "adequate", "physics", "faults", "formulas", "E in 2 std", "worst z", "std of E %", "s",
)  # fmt: skip


@dataclass(frozen=True)
class Options:
    """Discover on captures without any hidden effect."""

    kinds: Annotated[str, tyro.conf.arg(metavar="a,b")] = ",".join(NOISES)
    """Kinds of noise."""
    seeds: Annotated[str, tyro.conf.arg(metavar="0,1")] = "0,1"
    """Seeds of materials, marker places and noise."""
    shape: str = "bar"
    """The object."""
    markers: int = 60
    """Number of markers."""
    out: Path = Path("runs/nulls")
    """Folder for captures and results."""
    workers: int = 1
    """Commands side by side on this machine."""
    threads: int | None = None
    """Of each of them; default: the cores, shared out."""
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="tcp://HOST:PORT")] = None
    """Of dask.distributed, whose workers are used."""
    json: bool = False
    """Print one JSON object on standard output, and the rest on standard error."""


def captured(kind: str, seed: int, options: Options) -> Path:
    """The capture of a kind of noise, made unless it is there."""
    folder = options.out / "captures" / f"{options.shape}-{options.markers}-{kind}-{seed}"
    if not (folder / "answer.json").is_file():
        made = recipe(options.shape, seed=seed, noise=Noise(kind), marker_count=options.markers)
        make_capture(made, folder)
    return folder


def task_of(capture: Path, options: Options) -> Task:
    """Discover, with default options."""
    run, logs = Path(f"{capture.absolute()}-run"), options.out.absolute() / "logs"
    words = ("discover", str(capture.absolute()), "--out", str(run))
    return Task(
        capture.name, str(capture), words, run, logs, Path(os.getcwd()), limited=True, resumable=True
    )


def judged(found: Mapping[str, object], truth: Mapping[str, Mapping[str, float]]) -> dict[str, object]:
    """What was concluded, and how far every E is off. truth: by part, as of answer.json."""
    missing = found["missing_force"]
    told = found["steps"][-1]["parameters"]
    deviations, errors = {}, {}
    for part, material in truth.items():
        entry = told[f"{part}.youngs_modulus"]
        deviations[part] = (entry["value"] - material["E"]) / entry["std"]
        errors[part] = entry["std"] / entry["value"]
    return {
        "verdict": found["verdict"],
        "physics": [n for n in found["effects"] if effects()[n].kind != "measurement"],
        "faults": [n for n in found["effects"] if effects()[n].kind == "measurement"],
        "formula": None if missing is None else missing.get("formula"),
        "z": deviations,
        "relative_std": errors,
    }


def rows(records: Sequence[Mapping[str, object]]) -> list[str]:
    """The table: a line for each kind of noise, and one for all."""
    lines = [COLUMNS]
    kinds = list(dict.fromkeys(str(r["kind"]) for r in records))
    for name, kept in [*((k, [r for r in records if r["kind"] == k]) for k in kinds), ("all", records)]:
        z = [abs(value) for r in kept for value in r["z"].values()]
        std = [value for r in kept for value in r["relative_std"].values()]
        cells = [len(kept), sum(r["verdict"] == "adequate" for r in kept)]
        cells += [sum(bool(r[key]) for r in kept) for key in ("physics", "faults", "formula")]
        cells += [f"{sum(v <= STANDARD_ERRORS for v in z)} of {len(z)}", f"{max(z):.2f}"]
        cells += [f"{100.0 * np.median(std):.2g}", f"{np.median([r['seconds'] for r in kept]):.0f}"]
        lines.append((name, *map(str, cells)))
    head, *body = (f"| {' | '.join(line)} |" for line in lines)
    return [head, "|" + " --- |" * len(COLUMNS), *body]


def records_of(kinds: Sequence[str], seeds: Sequence[int], options: Options) -> list[dict[str, object]]:
    """What was concluded of every capture, those that are done already and new ones; not of what failed."""
    results, todo = options.out / "results", {}
    results.mkdir(parents=True, exist_ok=True)
    paths = {}
    for seed in seeds:
        for kind in kinds:
            path = results / f"{options.shape}-{options.markers}-{kind}-{seed}.json"
            paths[kind, seed] = path
            if not path.is_file():
                todo[task_of(captured(kind, seed, options), options)] = (kind, seed)

    def ended(task: Task, outcome: Outcome) -> None:
        kind, seed = todo[task]
        if outcome.answer is None:
            print(f"{kind}, seed {seed}: {outcome.line}", file=sys.stderr, flush=True)
            return
        truth = json.loads((Path(task.folder) / "answer.json").read_text())["parts"]
        seconds = max(outcome.seconds, float(outcome.answer.get("seconds", 0.0)))
        entry = plain(judged(outcome.answer, truth) | {"kind": kind, "seed": seed, "seconds": seconds})
        partial = paths[kind, seed].with_suffix(".part")
        partial.write_text(json.dumps(entry, indent=1) + "\n")
        partial.replace(paths[kind, seed])
        named = ", ".join([*entry["physics"], *entry["faults"]]) or "none"
        z = ", ".join(f"{value:.2f}" for value in entry["z"].values())
        print(f"{kind}, seed {seed}: {entry['verdict']}; {named}; z {z}", file=sys.stderr, flush=True)

    run_on_workers(list(todo), ended, options)
    return [json.loads(path.read_text()) for path in paths.values() if path.is_file()]


def main() -> int:
    """Run, print, and keep everything in the output folder."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    kinds = [k.strip() for k in options.kinds.split(",")]
    if unknown := [k for k in kinds if k not in NOISES]:
        print(f"--kinds: '{unknown[0]}'; expected some of {', '.join(NOISES)}", file=sys.stderr)
        return 2
    return exit_code_of(lambda: tabled(kinds, options), partial(print, file=sys.stderr))


def tabled(kinds: Sequence[str], options: Options) -> int:
    """Run all that is asked for, and tell it. Returns the exit code."""
    records = records_of(kinds, [int(s) for s in options.seeds.split(",")], options)
    if not records:
        return 1
    print("\n".join(rows(records)), file=sys.stderr if options.json else sys.stdout)
    if options.json:
        print(json.dumps({"records": records}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
