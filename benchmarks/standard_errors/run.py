"""How far E is off in standard errors: fits of captures whose truth was simulated in different ways.

    python benchmarks/standard_errors/run.py [--simulators mls] [--seeds 0,1] [--out DIR] [--json]

Captures and answers are kept in the output folder; what is there already is not run again, so an interrupted
benchmark goes on where it stopped.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

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
    workers: int = os.cpu_count() or 1
    """Simulations side by side."""
    json: bool = False
    """Print one JSON object on standard output, and the rest on standard error."""


def fitted(simulator: str, seed: int, options: Options) -> dict[str, dict[str, float]]:
    """By part, true E, fitted E and its standard error [Pa]. Raises RuntimeError where the fit fails."""
    folder = options.out / f"{options.shape}-{options.markers}-{options.frames}-{simulator}-{seed}"
    kept = folder.with_suffix(".json")
    if not (folder / "answer.json").is_file():
        made = recipe(
            options.shape,
            seed=seed,
            simulator=simulator,
            frames=options.frames,
            marker_count=options.markers,
        )
        make_capture(made, folder)
    if not kept.is_file():
        command = [sys.executable, "-m", "mphygs.fit", str(folder), "--out", f"{folder}-run", "--json"]
        done = subprocess.run(
            [*command, "--workers", str(options.workers)], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            raise RuntimeError(done.stderr.strip().splitlines()[-1])
        partial = kept.with_suffix(".part")
        partial.write_text(done.stdout)
        partial.replace(kept)
    truth, found = json.loads((folder / "answer.json").read_text()), json.loads(kept.read_text())
    told = {part: found["parameters"][f"{part}.youngs_modulus"] for part in truth["parts"]}
    return {
        part: {"true": truth["parts"][part]["E"], "value": entry["value"], "std": entry["std"]}
        for part, entry in told.items()
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
    records = []
    for seed in (int(s) for s in options.seeds.split(",")):
        for simulator in simulators:
            try:
                records.append((simulator, seed, fitted(simulator, seed, options)))
            except RuntimeError as error:
                print(f"{simulator}, seed {seed}: {error}", file=sys.stderr, flush=True)
    if not records:
        return 1
    lines = table(sorted(records, key=lambda r: r[0]))
    print("\n".join(lines), file=sys.stderr if options.json else sys.stdout)
    if options.json:
        print(json.dumps([{"simulator": s, "seed": k, "parts": parts} for s, k, parts in records]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
