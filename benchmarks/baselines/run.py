"""Baselines beside `discover` on captures in markers with a hidden effect: one table.

    python benchmarks/baselines/run.py [--cases viscosity,tilt] [--seeds 0] [--rows springs] [--out DIR]

Every row is one command on the same capture, in a process of its own: its error on the frames that were
fitted, on frames of that motion that were not, and on a motion that was not. Captures, runs and results are
kept in the output folder; what is there is not done again, and what was broken off goes on.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro
from table import markdown

from mphygs.baselines.kinds import NAMES
from mphygs.capture.json_values import plain
from mphygs.capture.motions import HoldMovement
from mphygs.synth.make import make_capture
from mphygs.synth.marker_noise import Noise
from mphygs.synth.recipe import Recipe, Take, recipe

# What is hidden, as of `mphygs synth --hidden`; nothing in "null".
CASES = {
    "null": (),
    "viscosity": ("viscosity:eta=50",),
    "drag": ("air_drag:c_d=10",),
    "tilt": ("gravity:delta_g_y=1:delta_g_z=0.4",),
    "tether": ("tether",),
    "actuation": ("actuation:amplitude=2000",),
}
# The method, the elastic model alone, and the baselines that take markers.
BASELINES = tuple(name for name in NAMES if name != "prior")
ROWS = ("discover", "elastic", *BASELINES)


@dataclass(frozen=True)
class Options:
    """Fit captures with a hidden effect by each baseline and by discover; print their errors."""

    cases: Annotated[str, tyro.conf.arg(metavar="a,b")] = ",".join(CASES)
    """Names of what is hidden."""
    seeds: Annotated[str, tyro.conf.arg(metavar="0,1")] = "0"
    """Seeds of materials, marker places, noise and networks."""
    rows: Annotated[str, tyro.conf.arg(metavar="a,b")] = ",".join(ROWS)
    """Which of discover, elastic and the baselines."""
    markers: int = 40
    """Markers of a capture."""
    out: Path = Path("runs/baselines")
    """Folder for captures, runs and results."""
    workers: int = 1
    """Simulations side by side, in each command."""
    json: bool = False
    """Print one JSON object on standard output, and the rest on standard error."""


def recipe_of(case: str, seed: int, markers: int) -> Recipe:
    """A bar of two materials, let go and shifted: to fit and predict; shaken: to predict alone."""
    shift = (HoldMovement("shift", 0.08, 0.33, by=(0.0, 0.018, 0.009)),)
    shake = (HoldMovement("shake", 0.08, 0.75, by=(0.0, 0.004, 0.004), frequency=4.0, ramp=0.2),)
    takes = (
        Take("release", shift, 60.0, 56, (0, 36), (36, 56), release=2),
        Take("shake", shake, 60.0, 50, (0, 0), (0, 50), release=2),
    )
    return recipe(
        "two-part-bar", hidden=CASES[case], seed=seed, name=case, noise=Noise("white"), takes=takes,
        marker_count=markers, known="densities",
    )  # fmt: skip


def capture_of(case: str, seed: int, options: Options) -> Path:
    """The case's capture, made unless it is there."""
    folder = options.out / "captures" / f"{case}-{seed}"
    kept = folder.with_suffix(".json")
    wanted = plain({"hidden": CASES[case], "seed": seed, "markers": options.markers})
    if not (kept.is_file() and json.loads(kept.read_text()) == wanted):
        shutil.rmtree(folder, ignore_errors=True)
        make_capture(recipe_of(case, seed, options.markers), folder)
        kept.write_text(json.dumps(wanted) + "\n")
    return folder


def command_of(row: str, capture: Path, run: Path, seed: int, workers: int) -> list[str]:
    """What makes, or goes on with, one row."""
    words = ["discover" if row == "discover" else "fit", str(capture), "--out", str(run)]
    words += ["--seed", str(seed), "--workers", str(workers)]
    words += ["--baseline", row] if row in BASELINES else []
    begun = (run / "run.json").is_file()
    return [sys.executable, "-m", "mphygs", *words, "--json", *(["--resume"] if begun else [])]


def errors_of(answer: Mapping[str, object]) -> dict[str, object]:
    """Errors of a row's answer [m] and over sigma: fitted and unseen frames, unseen motion."""
    steps = answer.get("steps")
    sequences = steps[-1]["sequences"] if steps else answer["sequences"]
    found = {
        "fitted": sequences["release"]["fit"],
        "frames": sequences["release"]["predict"],
        "motion": sequences["shake"]["predict"],
    }
    return {"errors": found, "effects": answer.get("effects"), "verdict": answer.get("verdict")}


def record(case: str, seed: int, row: str, options: Options) -> dict[str, object]:
    """One row of one capture, from its file where it is done already."""
    path = options.out / "results" / f"{case}-{seed}-{row}.json"
    spec = plain({"hidden": CASES[case], "seed": seed, "row": row, "markers": options.markers})
    if path.is_file():
        known = json.loads(path.read_text())
        if known["spec"] == spec and "error" not in known:
            return known
    print(f"{case}, seed {seed}, {row}", file=sys.stderr, flush=True)
    capture = capture_of(case, seed, options)
    began = time.perf_counter()
    run = options.out / "runs" / f"{case}-{seed}-{row}"
    done = subprocess.run(
        command_of(row, capture, run, seed, options.workers), capture_output=True, text=True, check=False
    )
    entry: dict[str, object] = {"case": case, "seed": seed, "row": row, "spec": spec}
    if done.returncode == 0:
        answer = json.loads(done.stdout)
        # what was broken off and goes on has spent some before
        seconds = max(time.perf_counter() - began, float(answer.get("seconds", 0.0)))
        entry |= errors_of(answer) | {"seconds": seconds}
    else:
        entry["error"] = (done.stderr.strip().splitlines() or ["nothing was said"])[-1]
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".part")
    partial.write_text(json.dumps(plain(entry), indent=1) + "\n")
    partial.replace(path)
    return entry


def chosen(text: str, known: tuple[str, ...]) -> list[str]:
    """Names of a list, all of them known. Raises ValueError."""
    found = [name.strip() for name in text.split(",") if name.strip()]
    for name in found:
        if name not in known:
            raise ValueError(f"'{name}': expected some of {', '.join(known)}")
    return found


def main() -> int:
    """Run, print, and keep everything in the output folder."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    try:
        cases, rows = chosen(options.cases, tuple(CASES)), chosen(options.rows, ROWS)
        seeds = [int(seed) for seed in options.seeds.split(",")]
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    records = [record(case, seed, row, options) for case in cases for seed in seeds for row in rows]
    text = markdown(records)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "table.md").write_text(text + "\n")
    print(text, file=sys.stderr if options.json else sys.stdout)
    if options.json:
        print(json.dumps(plain({"options": asdict(options) | {"out": str(options.out)}, "rows": records})))
    return 1 if any("error" in entry for entry in records) else 0


if __name__ == "__main__":
    sys.exit(main())
