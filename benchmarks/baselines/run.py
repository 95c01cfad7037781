"""Baselines beside `discover` on captures in markers with a hidden effect: one table.

    python benchmarks/baselines/run.py [--cases viscosity,tilt] [--seeds 0] [--rows springs] [--out DIR]

Every row is one command on the same capture, in a process of its own, on workers as `mphygs batch` has them:
its error on the frames that were fitted, on frames of that motion that were not, and on a motion that was
not. Captures, runs and results are kept in the output folder; what is there is not done again, and what was
broken off goes on.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from table import markdown

from mphygs.baselines.kinds import NAMES
from mphygs.batch.run_on_workers import exit_code_of, run_on_workers
from mphygs.batch.work import Outcome, Task
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
    """Commands side by side on this machine."""
    threads: int = 1
    """Of each of them."""
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="tcp://HOST:PORT")] = None
    """Of dask.distributed, whose workers are used."""
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


def task_of(case: str, seed: int, row: str, capture: Path, options: Options) -> Task:
    """What makes, or goes on with, one row."""
    name, out = f"{case}-{seed}-{row}", options.out.absolute()
    run = out / "runs" / name
    words = ["discover" if row == "discover" else "fit", str(capture.absolute()), "--out", str(run)]
    words += ["--seed", str(seed), *(["--baseline", row] if row in BASELINES else [])]
    return Task(
        name, str(capture), tuple(words), run, out / "logs", Path(os.getcwd()), limited=True, resumable=True
    )


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


@dataclass(frozen=True, eq=False)
class Row:
    """One row of one capture. spec: what tells it apart; path: of the file of its result."""

    case: str
    seed: int
    row: str
    spec: Mapping[str, object]
    path: Path

    @classmethod
    def of(cls, case: str, seed: int, row: str, options: Options) -> Row:
        spec = plain({"hidden": CASES[case], "seed": seed, "row": row, "markers": options.markers})
        return cls(case, seed, row, spec, options.out / "results" / f"{case}-{seed}-{row}.json")

    def known(self) -> dict[str, object] | None:
        """Its result, where it is done."""
        found = json.loads(self.path.read_text()) if self.path.is_file() else {}
        return found if found.get("spec") == self.spec and "error" not in found else None

    def keep(self, outcome: Outcome, *, whole: bool) -> dict[str, object]:
        """Its result as it comes of a command, in its file. whole: whether that began it as well."""
        entry = {"case": self.case, "seed": self.seed, "row": self.row, "spec": self.spec}
        if outcome.answer is not None:
            # what was broken off and goes on has spent some before
            seconds = max(outcome.seconds, float(outcome.answer.get("seconds", 0.0)))
            entry |= errors_of(outcome.answer) | {"seconds": seconds}
            entry |= {"processor": outcome.processor} if whole else {}
        else:
            entry["error"] = outcome.line
        entry = plain(entry)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        partial = self.path.with_suffix(".part")
        partial.write_text(json.dumps(entry, indent=1) + "\n")
        partial.replace(self.path)
        return entry


def records_of(rows: list[Row], options: Options) -> list[dict[str, object]]:
    """The results of all rows, those that are there already and new ones."""
    found = {row: row.known() for row in rows}
    todo = {}
    for row in (row for row in rows if found[row] is None):
        capture = capture_of(row.case, row.seed, options)
        todo[task_of(row.case, row.seed, row.row, capture, options)] = row
    begun = {task for task in todo if task.log.exists()}

    def ended(task: Task, outcome: Outcome) -> None:
        found[todo[task]] = todo[task].keep(outcome, whole=task not in begun)
        print(f"{task.name}: {outcome.line or 'done'}", file=sys.stderr, flush=True)

    run_on_workers(list(todo), ended, options)
    return list(found.values())


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
    return exit_code_of(lambda: tabled(options), partial(print, file=sys.stderr))


def tabled(options: Options) -> int:
    """Run all that is asked for and tell it; the exit code. Raises ValueError for unknown names."""
    cases, rows = chosen(options.cases, tuple(CASES)), chosen(options.rows, ROWS)
    seeds = [int(seed) for seed in options.seeds.split(",")]
    wanted = [Row.of(case, seed, row, options) for case in cases for seed in seeds for row in rows]
    records = records_of(wanted, options)
    text = markdown(records)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "table.md").write_text(text + "\n")
    print(text, file=sys.stderr if options.json else sys.stdout)
    if options.json:
        print(json.dumps(plain({"options": asdict(options) | {"out": str(options.out)}, "rows": records})))
    return 1 if any("error" in entry for entry in records) else 0


if __name__ == "__main__":
    sys.exit(main())
