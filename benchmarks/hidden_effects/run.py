"""How well the loop finds hidden effects: cases times seeds, one table.

    python benchmarks/hidden_effects/run.py [--cases null,viscosity-*] [--seeds 0,1] [--out DIR] [--json]

Every capture is made and every loop run by a command in a process of its own, on workers as `mphygs batch`
has them. Captures, runs and results are kept in the output folder; what is there already, for the same case,
is not done again, and what was broken off goes on.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro
from cases import Case, chosen
from judge import record
from make import is_made
from table import right, rows, summary, summary_text

from mphygs.batch.run_on_workers import exit_code_of, run_on_workers
from mphygs.batch.work import Outcome, Task
from mphygs.capture.format import load_capture
from mphygs.capture.json_values import plain
from mphygs.fit.spacings import default_spacing

MAKE = Path(__file__).resolve().with_name("make.py")


@dataclass(frozen=True)
class Options:
    """Run the loop on captures with known truth and print how well it does."""

    cases: Annotated[str, tyro.conf.arg(metavar="a,b")] = ""
    """Names (with * and ?) or groups: null, single, pair, outside, fault, near, trap. Default: all."""
    seeds: Annotated[str, tyro.conf.arg(metavar="0,1")] = "0,1"
    """Seeds of materials, marker places and noise."""
    out: Path = Path("runs/hidden_effects")
    """Folder for captures, runs and results."""
    again: bool = False
    """Run discovery again where there is a result; captures are kept."""
    workers: int = 1
    """Commands side by side on this machine."""
    threads: int | None = None
    """Of each of them; default: the cores, shared out."""
    scheduler: Annotated[str | None, tyro.conf.arg(metavar="tcp://HOST:PORT")] = None
    """Of dask.distributed, whose workers are used."""
    json: bool = False
    """Print one JSON object on standard output, and the rest on standard error."""


@dataclass(frozen=True, eq=False)
class Job:
    """One case and seed, in the folder `out`."""

    case: Case
    seed: int
    out: Path

    @property
    def name(self) -> str:
        return f"{self.case.name}-{self.seed}"

    @property
    def capture(self) -> Path:
        return self.out.absolute() / "captures" / self.name

    @property
    def result(self) -> Path:
        return self.out / "results" / f"{self.name}.json"

    @property
    def run(self) -> Path:
        return self.out.absolute() / "runs" / self.name

    def known(self) -> dict[str, object] | None:
        """Its record, where it is done."""
        found = json.loads(self.result.read_text()) if self.result.is_file() else {}
        return found if found.get("spec") == plain(asdict(self.case)) and "error" not in found else None

    def begin(self, *, again: bool) -> Task:
        """What can be run first. again: from the beginning of the loop."""
        if not is_made(self.capture, self.case, self.seed):
            again = True
        if again:
            self.result.unlink(missing_ok=True)
            shutil.rmtree(self.run, ignore_errors=True)
            self._discovery(()).log.unlink(missing_ok=True)
        return self._next()

    def ended(self, task: Task, outcome: Outcome) -> list[Task]:
        """Keep what came of a task. What can be run after it."""
        if task.script is not None and outcome.done:
            return [self._next()]
        entry = {"case": self.case.name, "group": self.case.group, "seed": self.seed}
        if not outcome.done:
            entry["error"] = outcome.line
        else:
            # what was broken off and goes on has spent some before
            seconds = max(outcome.seconds, float(outcome.answer.get("seconds", 0.0)))
            entry |= record(self.case, self.capture, self.run, outcome.answer) | {"seconds": seconds}
        entry = plain(entry | {"spec": asdict(self.case)})
        self.result.parent.mkdir(parents=True, exist_ok=True)
        partial = self.result.with_suffix(".part")
        partial.write_text(json.dumps(entry, indent=1) + "\n")
        partial.replace(self.result)
        outcome = entry.get("error") or f"{entry['verdict']}: {', '.join(entry['effects']) or 'none'}"
        said = f"{self.name}: {'right' if right(entry) else 'WRONG'}: {outcome}"
        print(said, file=sys.stderr, flush=True)
        return []

    def _next(self) -> Task:
        if not is_made(self.capture, self.case, self.seed):
            words = (self.case.name, str(self.seed), str(self.capture))
            return self._task(f"{self.name}-capture", words, script=MAKE)
        if self.case.fit_spacing == 1.0:
            return self._discovery(())
        spacing = self.case.fit_spacing * default_spacing(load_capture(self.capture))
        return self._discovery(("--spacing", str(spacing)))

    def _discovery(self, more: tuple[str, ...]) -> Task:
        """The loop with its default options, but for cases that are about the grid."""
        words = ("discover", str(self.capture), "--out", str(self.run), "--seed", str(self.seed), *more)
        return self._task(self.name, words, run=self.run, limited=True, resumable=True)

    def _task(self, name: str, words: tuple[str, ...], *, run: Path | None = None, **more: object) -> Task:
        logs, known = self.out.absolute() / "logs", {"limited": False, "resumable": False} | more
        return Task(name, str(self.capture), words, run, logs, Path(os.getcwd()), **known)


def records_of(jobs: Sequence[Job], options: Options) -> list[dict[str, object]]:
    """The records of all jobs, those that are there already and new ones."""
    todo = [job for job in jobs if options.again or job.known() is None]
    of = {job.begin(again=options.again): job for job in todo}

    def ended(task: Task, outcome: Outcome) -> list[Task]:
        job = of[task]
        after = job.ended(task, outcome)
        of.update(dict.fromkeys(after, job))
        return after

    run_on_workers(list(of), ended, options)
    return [json.loads(job.result.read_text()) for job in jobs]


def main() -> int:
    """Run, print, and keep everything in the output folder."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    return exit_code_of(lambda: tabled(options), partial(print, file=sys.stderr))


def tabled(options: Options) -> int:
    """Run all that is asked for and tell it; the exit code. Raises ValueError for unknown names."""
    wanted = chosen([c.strip() for c in options.cases.split(",") if c.strip()])
    jobs = [Job(case, int(seed), options.out) for seed in options.seeds.split(",") for case in wanted]
    records = records_of(jobs, options)
    numbers = summary(records)
    text = sys.stderr if options.json else sys.stdout
    print("\n".join([*rows(records), "", *summary_text(numbers)]), file=text)
    if options.json:
        print(json.dumps({"summary": plain(numbers), "cases": records}))
    return 1 if numbers["errors"] else 0


if __name__ == "__main__":
    sys.exit(main())
