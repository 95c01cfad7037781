"""What the grid's spacing costs and does: misfit at the true and at fitted materials, verdicts, time.

    python benchmarks/discretisation/run.py [CAPTURE ...] [--spacings 1.7,1.3,1,0.75] [--out DIR] [--write]

CAPTURE: folders with an answer.json, told by a simulator that is not the one fitted. Without one, two bars of
the package's own finite elements are made: one elastic, one viscous. The true effects are switched on for the
fits; the verdicts are those of the loop, which starts from elasticity alone and stays on the spacing. Results
are kept in the output folder: what is there is not run again.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from mphygs.capture.format import Capture, load_capture
from mphygs.capture.json_values import plain
from mphygs.commands.synth import main as synth
from mphygs.extend.conclusion import Discovery
from mphygs.extend.discovery import discover_effects
from mphygs.extend.first_fit import first_fit
from mphygs.fit.experiment import Experiment
from mphygs.fit.placement import with_placed_effect
from mphygs.fit.spacings import default_spacing
from mphygs.fit.start import starting_belief
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.settings import Settings

README = Path(__file__).parents[1] / "README.md"
MARKS = ("<!-- discretisation begin -->", "<!-- discretisation end -->")
OWN = {"bar-elastic": "", "bar-viscous": "viscosity"}
NAMES = {"E": "youngs_modulus", "rho": "density", "nu": "poissons_ratio"}
REPEATS = 3


@dataclass(frozen=True)
class Options:
    """Fit captures of an independent simulator on several spacings, and let the loop judge on each."""

    captures: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Folders of captures with an answer.json; default: two bars, made by finite elements."""
    spacings: Annotated[str, tyro.conf.arg(metavar="1.7,1")] = "1.7,1.3,1,0.75"
    """Spacings over the default one."""
    out: Path = Path("runs/discretisation")
    """Folder for captures and results."""
    workers: int = os.cpu_count() or 1
    """Simulations side by side."""
    write: bool = False
    """Put the table into benchmarks/README.md."""


def own_captures(out: Path) -> tuple[Path, ...]:
    """Two bars of the finite-element simulator, made unless they are there."""
    folders = tuple(out / "captures" / name for name in OWN)
    for folder, hidden in zip(folders, OWN.values(), strict=True):
        if not (folder / "answer.json").is_file():
            command = ["two-part-bar", "--simulator", "finite-element", "--out", str(folder)]
            if synth([*command, *(["--hidden", hidden] if hidden else [])]):
                raise SystemExit(f"{folder}: could not be made")
    return folders


def with_truth(belief: Belief, answer: dict, names: Sequence[str]) -> Belief:
    """The belief at the capture's true materials and effects."""
    truth = {
        f"{part}.{NAMES[key]}": value
        for part, numbers in answer["parts"].items()
        for key, value in numbers.items()
        if key in NAMES
    }
    truth |= {f"{name}.{key}": v for name in names for key, v in answer["effects"][name].items()}
    for p in belief.parameters:
        if p.key in truth:
            value = float(truth[p.key])
            belief = belief.with_parameter(
                p.key, value=value, lower=min(p.lower, value), upper=max(p.upper, value)
            )
    return belief


def misfit(experiment: Experiment, belief: Belief, spacing: float) -> dict[str, float]:
    """Root mean square of the whitened residual, by sequence and range."""
    ratio = experiment.assess(experiment.compare(belief, spacing)).ratio
    return {f"{name} {label}": value for name, ranges in ratio.items() for label, value in ranges.items()}


def simulation(experiment: Experiment, belief: Belief, spacing: float) -> tuple[float, float]:
    """Median seconds of one forward run of the first sequence, and its substep [s]."""
    name = next(iter(experiment.fitted))
    predictor = experiment.predictor(name, spacing)
    substep = predictor.stable_substep(belief)
    seconds = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        # A copy: a prediction of the same object that is kept would come back.
        predictor.predict(replace(belief), substep=substep)
        seconds.append(time.perf_counter() - began)
    return float(np.median(seconds)), substep


def measured(capture: Capture, answer: dict, factor: float, options: Options) -> dict:
    """One row: misfit at the truth and fitted, the loop's verdict, times."""
    spacing = factor * default_spacing(capture)
    settings = Settings(spacing=spacing, workers=options.workers)
    names = [name for name in answer["effects"] if name != "none"]
    experiment = Experiment.of(capture, settings)
    start = experiment.starting(starting_belief(capture))
    for name in names:
        start = with_placed_effect(start, name, capture, tuple(experiment.fitted))
    true = with_truth(start, answer, names)
    try:
        at_truth, start = misfit(experiment, true, spacing), true
    except SimulationError as error:  # a thin neck may be too soft on a coarse grid to carry its weight
        print(f"    at the truth: {error}", file=sys.stderr, flush=True)
        at_truth = None
    began = time.perf_counter()
    fitted = first_fit(experiment, start, spacing, warm=start is true)
    fit_seconds = time.perf_counter() - began
    seconds, substep = simulation(experiment, fitted.belief, spacing)
    budget = experiment.assess(experiment.compare(fitted.belief, spacing, refine=True)).budget
    began = time.perf_counter()
    found = discover_effects(Experiment.of(capture, settings), starting_belief(capture), spacing)
    return {
        "spacing": spacing,
        "true": at_truth,
        "fitted": misfit(experiment, fitted.belief, spacing),
        "budget": budget,
        "values": {p.key: p.value for p in fitted.belief.free},
        "simulation_s": seconds,
        "substep": substep,
        "fit_s": fit_seconds,
        "loop_s": time.perf_counter() - began,
        **judged(found),
    }


def judged(found: Discovery) -> dict:
    """The loop's verdict and how far its last model is from the noise."""
    last = found.steps[-1].assessment
    ties = sorted({name for step in found.steps for name in step.ties})
    return {"verdict": found.verdict, "effects": found.effects, "ties": ties, "worst": last.worst}


def table(results: dict[str, list[dict]]) -> list[str]:
    """The rows as Markdown."""
    lines = [
        "| capture | grid [mm] | substep [us] | simulation [s] | misfit at the truth | fitted "
        "| the grid's share [mm] | verdict of the loop | its misfit |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, rows in results.items():
        for row in rows:
            told = ", ".join(row["effects"]) + (f" (ties {', '.join(row['ties'])})" if row["ties"] else "")
            lines.append(
                f"| {name} | {1e3 * row['spacing']:.1f} | {1e6 * row['substep']:.0f} "
                f"| {row['simulation_s']:.2f} | {_numbers(row['true'])} | {_numbers(row['fitted'])} "
                f"| {1e3 * row['budget'].get('discretisation', 0.0):.3f} | {row['verdict']}"
                f"{': ' + told if told else ''} | {row['worst']:.3f} |"
            )
    fallen = "*falls over*: cannot carry its weight on that grid."
    lines += ["", f"Misfits are over sigma: {'; '.join(_order(results))}; {fallen}"]
    return lines


def _numbers(ratios: dict[str, float] | None) -> str:
    if ratios is None:
        return "falls over"
    return " / ".join(f"{value:.3g}" if value > 2 else f"{value:.3f}" for value in ratios.values())


def _order(results: dict[str, list[dict]]) -> list[str]:
    return [f"{name}: {' / '.join(rows[0]['fitted'])}" for name, rows in results.items()]


def main() -> int:
    """Run, keep, print; with --write, into the README."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    factors = [float(f) for f in options.spacings.split(",")]
    folders = options.captures or own_captures(options.out)
    results: dict[str, list[dict]] = {}
    for folder in folders:
        capture = load_capture(folder)
        answer = json.loads((folder / "answer.json").read_text())
        for factor in factors:
            path = options.out / "results" / f"{folder.name}-{factor:g}.json"
            if not path.is_file():
                print(f"{folder.name} at {factor:g} of the default spacing", file=sys.stderr, flush=True)
                path.parent.mkdir(parents=True, exist_ok=True)
                row = plain(measured(capture, answer, factor, options))
                path.write_text(json.dumps(row, indent=1) + "\n")
            results.setdefault(folder.name, []).append(json.loads(path.read_text()))
    lines = table(results)
    print("\n".join(lines))
    if options.write:
        text = README.read_text()
        begin, end = (text.index(mark) for mark in MARKS)
        README.write_text("\n".join([text[:begin] + MARKS[0], *lines, text[end:]]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
