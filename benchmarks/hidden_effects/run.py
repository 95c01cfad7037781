"""How well the loop finds hidden effects: cases times seeds, one table.

    python benchmarks/hidden_effects/run.py [--cases null,viscosity-*] [--seeds 0,1] [--out DIR] [--json]

Captures and results are kept in the output folder; what is there already, for the same case, is not run
again, so an interrupted benchmark goes on where it stopped.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro
from cases import Case, chosen
from judge import record
from table import right, rows, summary, summary_text

from mphygs.capture.format import load_capture
from mphygs.capture.json_values import plain
from mphygs.extend.discovery import discover_effects
from mphygs.fit.experiment import Experiment
from mphygs.fit.spacings import default_spacing, screening_spacing
from mphygs.fit.start import starting_belief
from mphygs.simulate.prediction import Settings
from mphygs.synth.make import make_capture


@dataclass(frozen=True)
class Options:
    """Run the loop on captures with known truth and print how well it does."""

    cases: Annotated[str, tyro.conf.arg(metavar="a,b")] = ""
    """Names (with * and ?) or groups: null, single, pair, outside, fault, near, trap. Default: all."""
    seeds: Annotated[str, tyro.conf.arg(metavar="0,1")] = "0,1"
    """Seeds of materials, marker places and noise."""
    out: Path = Path("runs/hidden_effects")
    """Folder for captures and results."""
    again: bool = False
    """Run discovery again where there is a result; captures are kept."""
    workers: int = os.cpu_count() or 1
    """Simulations side by side."""
    json: bool = False
    """Print one JSON object on standard output, and the rest on standard error."""


def capture_of(case: Case, seed: int, folder: Path) -> dict:
    """The answer of the case's capture, made unless it is there."""
    answer, kept = folder / "answer.json", folder / "case.json"
    wanted = plain({"case": asdict(case), "seed": seed})
    if not (answer.is_file() and kept.is_file() and json.loads(kept.read_text()) == wanted):
        shutil.rmtree(folder, ignore_errors=True)
        make_capture(case.recipe(seed), folder)
        kept.write_text(json.dumps(wanted) + "\n")
    return json.loads(answer.read_text())


def run_case(case: Case, seed: int, options: Options, say: object) -> dict:
    """Make the capture, let the loop loose on it with its default options, and judge."""
    folder = options.out / "captures" / f"{case.name}-{seed}"
    try:
        answer = capture_of(case, seed, folder)
        capture = load_capture(folder)
        # As the command does it, but for cases that are about the grid.
        screening = case.fit_spacing == 1.0
        spacing = screening_spacing(capture) if screening else case.fit_spacing * default_spacing(capture)
        experiment = Experiment.of(capture, Settings(spacing=spacing, workers=options.workers))
        began = time.perf_counter()
        found = discover_effects(
            experiment, starting_belief(capture), spacing, seed=seed, screening=screening, report=say
        )
        entry = record(case, answer, found, experiment, time.perf_counter() - began)
    except (
        Exception
    ) as error:  # whatever one case trips over, the others go on, and it is run again next time
        entry = {"case": case.name, "group": case.group, "error": f"{type(error).__name__}: {error}"}
    return plain(entry | {"seed": seed, "spec": asdict(case)})


def main() -> int:
    """Run, print, and keep everything in the output folder."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    text = sys.stderr if options.json else sys.stdout
    try:
        wanted = chosen([c.strip() for c in options.cases.split(",") if c.strip()])
        seeds = [int(s) for s in options.seeds.split(",")]
    except ValueError as error:
        print(error, file=sys.stderr)
        return 2
    results = options.out / "results"
    results.mkdir(parents=True, exist_ok=True)
    records = []
    jobs = [(case, seed) for seed in seeds for case in wanted]
    for number, (case, seed) in enumerate(jobs):
        path = results / f"{case.name}-{seed}.json"
        if path.is_file() and not options.again:
            entry = json.loads(path.read_text())
            if entry["spec"] == plain(asdict(case)) and "error" not in entry:
                records.append(entry)
                continue
        print(f"[{number + 1}/{len(jobs)}] {case.name}, seed {seed}", file=sys.stderr, flush=True)
        with (results / f"{case.name}-{seed}.log").open("w") as log:
            entry = run_case(case, seed, options, lambda line, log=log: print(line, file=log, flush=True))
        partial = path.with_suffix(".part")
        partial.write_text(json.dumps(entry, indent=1) + "\n")
        partial.replace(path)
        records.append(entry)
        outcome = entry.get("error") or f"{entry['verdict']}: {', '.join(entry['effects']) or 'none'}"
        print(f"    {'right' if right(entry) else 'WRONG'}: {outcome}", file=sys.stderr, flush=True)
    numbers = summary(records)
    print("\n".join([*rows(records), "", *summary_text(numbers)]), file=text)
    if options.json:
        print(json.dumps({"summary": plain(numbers), "cases": records}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
