"""What it costs to score every smooth effect at once: tangents of all candidates beside one forward run.

    python benchmarks/diagnose/run.py [CAPTURE ...] [--rounds 5]

Fits elasticity alone to each capture, on the grid that effects are scored on, which is coarser than that of a
fit: one forward run on each stands beside the tangents. Without a capture, a bar with a hidden viscosity is
made. The runs take turns, so that what else the machine does is felt by all.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from mphygs.capture.format import load_capture
from mphygs.commands.synth import main as synth
from mphygs.diagnose.effect_variants import smooth_variants
from mphygs.diagnose.periodic_variants import swing_variants
from mphygs.extend.first_fit import first_fit
from mphygs.fit.experiment import Experiment
from mphygs.fit.placement import masses_of_loads
from mphygs.fit.spacings import default_spacing, screening_spacing
from mphygs.fit.start import starting_belief
from mphygs.model.registry import effect
from mphygs.simulate.settings import Settings

# As many frequencies of a shaking frame as a diagnosis asks for.
SHAKES = 4


@dataclass(frozen=True)
class Options:
    """Time the tangents of all smooth candidates beside one forward run."""

    captures: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Folders of captures; default: a bar with a hidden viscosity."""
    rounds: int = 5
    """Of which the medians are told."""
    out: Path = Path("runs/diagnose")
    """Folder for the bar."""
    workers: int = os.cpu_count() or 1
    """Simulations side by side."""


def own_capture(out: Path) -> Path:
    """The bar, made unless it is there."""
    folder = out / "bar"
    if not (folder / "answer.json").is_file() and synth(
        ["two-part-bar", "--hidden", "viscosity", "--out", str(folder)]
    ):
        raise SystemExit(f"{folder}: could not be made")
    return folder


def measured(folder: Path, options: Options) -> str:
    """One row of the table."""
    capture = load_capture(folder)
    spacing = screening_spacing(capture)
    experiment = Experiment.of(capture, Settings(spacing=spacing, workers=options.workers))
    belief = first_fit(experiment, experiment.starting(starting_belief(capture)), spacing).belief
    name, (_first, last) = next(iter(experiment.fitted.items()))
    predictor = experiment.predictor(name, spacing)
    finer = experiment.predictor(name, default_spacing(capture))
    ways = smooth_variants(belief, predictor.body, hung=masses_of_loads(capture, [name]))
    ways += swing_variants(belief, effect("base_motion"), [float(f) for f in range(1, SHAKES + 1)])
    columns = [pair for way in ways for pair in way.columns]
    substep, fine_substep = predictor.stable_substep(belief), finer.stable_substep(belief)
    # Copies: a prediction of the same object that is kept would come back.
    turns = {
        "forward": lambda: predictor.predict(replace(belief), last=last, substep=substep),
        "fit": lambda: finer.predict(replace(belief), last=last, substep=fine_substep),
        "tangents": lambda: predictor.predict(belief, last=last, substep=substep, candidates=columns),
    }
    seconds: dict[str, list[float]] = {what: [] for what in turns}
    for _ in range(options.rounds):
        for what, turn in turns.items():
            began = time.perf_counter()
            turn()
            seconds[what].append(time.perf_counter() - began)
    forward, fit, tangents = (float(np.median(values)) for values in seconds.values())
    effects = len({way.effect for way in ways})
    return (
        f"| {folder.name} | {1e3 * spacing:.1f} | {effects} | {len(columns)} | {forward:.2f} "
        f"| {fit:.2f} | {tangents:.2f} | {tangents / forward:.1f} | {tangents / fit:.1f} "
        f"| {tangents / forward / len(columns):.2f} |"
    )


def main() -> int:
    """Print the table."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    heads = (
        "capture", "grid [mm]", "effects", "parameters", "forward [s]", "of the fit [s]", "tangents [s]",
        "ratio", "to the fit's", "each",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
    for folder in options.captures or (own_capture(options.out),):
        print(measured(folder, options), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
