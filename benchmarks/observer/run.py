"""What feedback from the measurement costs: an iteration of a fit under it, beside a free one.

    python benchmarks/observer/run.py [CAPTURE ...] [--transfers total-lagrangian mls] [--rounds 7]

An iteration is the motion with its derivatives by all free numbers; the motion alone stands beside it.
Without a capture, a bar of two materials is made, and looked at with all of its markers and with one in
eight. The runs take turns, so that what else the machine does is felt by all; times are the processor's.
"""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from mphygs.capture.format import Capture, load_capture
from mphygs.capture.markers import Markers
from mphygs.commands.synth import main as synth
from mphygs.fit.experiment import Experiment
from mphygs.fit.spacings import default_spacing
from mphygs.fit.start import starting_belief
from mphygs.simulate.settings import Settings


@dataclass(frozen=True)
class Options:
    """Time an iteration under feedback beside a free one."""

    captures: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Folders of captures; default: a bar of two materials."""
    transfers: tuple[str, ...] = ("total-lagrangian",)
    """Transfers to simulate with: total-lagrangian, mls."""
    rounds: int = 7
    """Of which the medians are told."""
    out: Path = Path("runs/observer")
    """Folder for the bar."""
    workers: int = os.cpu_count() or 1
    """Cores that a run may use."""


def own_capture(out: Path) -> Path:
    """The bar, made unless it is there."""
    folder = out / "bar"
    if not (folder / "answer.json").is_file() and synth(["two-part-bar", "--out", str(folder)]):
        raise SystemExit(f"{folder}: could not be made")
    return folder


def thinned(markers: Markers) -> Markers:
    """One marker in eight."""
    seen, at, names = markers.position[:, ::8], markers.at[::8], markers.names[::8]
    scatter = None if markers.scatter is None else markers.scatter[::8]
    return replace(markers, position=seen, at=at, names=names, scatter=scatter)


def measured(name: str, capture: Capture, transfer: str, options: Options) -> str:
    """One row of the table."""
    spacing = default_spacing(capture)
    settings = Settings(spacing=spacing, workers=options.workers, transfer=transfer)
    experiment = Experiment.of(capture, settings)
    belief = experiment.starting(starting_belief(capture))
    problem = experiment.problem(spacing)
    problem = replace(problem, substep=problem.stable_substep(belief))
    seconds: dict[tuple[float, bool], list[float]] = {(g, j): [] for g in (0.0, 1.0) for j in (False, True)}
    for _ in range(options.rounds):
        for (gain, jacobian), taken in seconds.items():
            # A copy: a prediction of the same object that is kept would come back.
            own, began = replace(belief), time.process_time()
            problem.under(gain).evaluate(own, jacobian=jacobian)
            taken.append(time.process_time() - began)
    median = {key: float(np.median(taken)) for key, taken in seconds.items()}
    motion, iteration = (median[1.0, j] / median[0.0, j] for j in (False, True))
    carriers = len(next(iter(problem.predictors.values())).transfer.places_at_rest())
    markers = max(len(p.attachment.anchor) for p in problem.predictors.values())
    times = f"{median[0.0, False]:.2f} | {motion:.2f} | {median[0.0, True]:.2f} | {iteration:.2f}"
    return f"| {name} | {transfer} | {carriers} | {markers} | {len(belief.free)} | {times} |"


def main() -> int:
    """Print the table."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    sizes = ("capture", "transfer", "nodes or particles", "markers", "numbers")
    heads = (*sizes, "motion [s]", "under feedback", "iteration [s]", "under feedback")
    print(f"| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
    captures = {folder.name: load_capture(folder) for folder in options.captures}
    if not captures:
        whole = load_capture(own_capture(options.out))
        fewer = tuple(replace(s, markers=thinned(s.markers)) for s in whole.sequences)
        captures = {"bar": whole, "bar, fewer markers": replace(whole, sequences=fewer)}
    for name, capture in captures.items():
        for transfer in options.transfers:
            print(measured(name, capture, transfer, options), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
