"""What implicit steps cost beside explicit ones, from soft to stiff, and how exact they are.

    python benchmarks/implicit/run.py [--moduli 1e5 1e6 ...] [--frames 6] [--rounds 3] [--bodies]

A stem of 8 x 8 x 400 mm on a hold that is shaken, 60 frames a second. The two take turns; seconds are the
processor's, medians of the rounds; errors are those of the markers beside an explicit run in double precision
with substeps a quarter as long. With --bodies: one step of each kind on bodies of other shapes, and what
`auto` takes an implicit step to cost.
"""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
import tyro

from mphygs.capture.format import Capture, Hold, Known, Markers, Part, Sequence
from mphygs.fit.start import starting_belief
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import AUTO, EXPLICIT, IMPLICIT, Settings

FPS = 60.0


@dataclass(frozen=True)
class Options:
    """Time implicit steps beside explicit ones."""

    moduli: tuple[float, ...] = (1e5, 1e6, 1e7, 1e8, 1e9)
    """Young's moduli of the stem [Pa]."""
    frames: int = 6
    """Frames of the motion."""
    spacing: float = 0.008
    """Spacing of the grid [m]."""
    rounds: int = 3
    """Of which the medians are told."""
    bodies: bool = False
    """Compare slender, thick and branched bodies."""


# Name, spacing [m], Young's modulus [Pa], boxes by two corners [m]; the first is held at its lower end.
BODIES = (
    ("stem 8 x 8 x 400 mm", 0.008, 1e8, (((-0.008, 0, 0), (0.4, 0.008, 0.008)),)),
    ("bar 80 x 80 x 400 mm", 0.02, 2e9, (((-0.02, 0, 0), (0.4, 0.08, 0.08)),)),
    ("the same, finer", 0.012, 1e9, (((-0.02, 0, 0), (0.4, 0.08, 0.08)),)),
    (
        "stem with six leaves", 0.008, 1e8,
        (
            ((-0.008, 0, 0), (0.4, 0.008, 0.008)),
            *(
                ((x, low, -0.028), (x + 0.006, low + 0.064, 0.036))
                for x in (0.394, 0.35, 0.3)
                for low in (-0.064, 0.008)
            ),
        ),
    ),
)  # fmt: skip


def stem(frames: int, boxes: tuple = BODIES[0][3]) -> Capture:
    """The stem, or another body, and its motion."""
    times = np.arange(frames) / FPS
    shaken = np.zeros((frames, 3))
    shaken[:, 1] = 0.01 * np.sin(2 * np.pi * 3.0 * times) * np.minimum(times / 0.15, 1.0)
    meshes = [trimesh.creation.box(bounds=np.array(box)) for box in boxes]
    at = np.array([[s, 0.004, 0.004] for s in np.linspace(0.05, 0.4, 8)])
    hold = Hold(np.array([[-1.0, -1, -1], [0.0, 1, 1]]), shaken, np.tile([1.0, 0, 0, 0], (frames, 1)))
    markers = Markers(np.tile(at, (frames, 1, 1)), at, 1e-4)
    recording = Sequence("a", FPS, frames, (0, frames), (0, 0), (hold,), markers=markers)
    parts = tuple(
        Part("stem" if i == 0 else f"leaf{i}", np.array(mesh.vertices), np.array(mesh.faces))
        for i, mesh in enumerate(meshes)
    )
    known = Known(density={part.name: 800.0 for part in parts}, poissons_ratio=0.3)
    return Capture("stem", Path("."), np.array([0.0, 0, -9.81]), parts, "stress-free", known, (recording,))


def belief_of(capture: Capture, modulus: float) -> Belief:
    """Of one Young's modulus [Pa]."""
    belief = starting_belief(capture)
    for part in capture.parts:
        for key, value in {"youngs_modulus": modulus, "density": 800.0}.items():
            lower, upper = min(1e3, value), max(1e10, value)
            belief = belief.with_parameter(f"{part.name}.{key}", value=value, lower=lower, upper=upper)
    return belief


def timed(predictor: Predictor, belief: Belief, *, gradient: bool) -> tuple[float, np.ndarray]:
    """Seconds of the processor, and the markers. A copy of the belief: what is kept would come back."""
    own, last = replace(belief), predictor.recording.frames
    began = time.process_time()
    if gradient:
        found, _ = predict_with_gradient(predictor, own, np.copy, keys=("stem.youngs_modulus",), last=last)
    else:
        found = predictor.predict(own)
    return time.process_time() - began, found.position


def row(modulus: float, options: Options) -> str:
    """One row of the table."""
    capture = stem(options.frames)
    belief = belief_of(capture, modulus)
    settings = Settings(options.spacing, workers=1)

    def predictor(integrator: str, **more: object) -> Predictor:
        own = replace(settings, integrator=integrator, **more)
        return Predictor(capture, capture.sequence("a"), own)

    exact = predictor(EXPLICIT, dtype="float64", safety=settings.safety / 4).predict(belief).position
    both = {name: predictor(name) for name in (EXPLICIT, IMPLICIT)}
    seconds: dict[tuple[str, bool], list[float]] = {(n, g): [] for n in both for g in (False, True)}
    error = {}
    for _ in range(options.rounds):
        for (name, gradient), taken in seconds.items():
            spent, position = timed(both[name], belief, gradient=gradient)
            taken.append(spent)
            error[name] = float(np.sqrt(np.mean((position - exact) ** 2)))
    median = {key: float(np.median(taken)) for key, taken in seconds.items()}
    substeps = both[IMPLICIT].stable_substep(belief) / both[EXPLICIT].stable_substep(belief)
    chosen = IMPLICIT if predictor(AUTO).implicit(belief) else EXPLICIT
    ratios = [median[EXPLICIT, g] / median[IMPLICIT, g] for g in (False, True)]
    return (
        f"| {modulus:.0e} | {substeps:.0f} | {median[EXPLICIT, False]:.2f} | {median[IMPLICIT, False]:.2f} | "
        f"{ratios[0]:.2g} | {median[EXPLICIT, True]:.2f} | {median[IMPLICIT, True]:.2f} | {ratios[1]:.2g} | "
        f"{1e6 * error[EXPLICIT]:.2g} | {1e6 * error[IMPLICIT]:.2g} | {chosen} |"
    )


def body_row(name: str, spacing: float, modulus: float, boxes: tuple, options: Options) -> str:
    """One row of the table of bodies."""
    capture = stem(options.frames, boxes)
    belief = belief_of(capture, modulus)
    predictors = {
        integrator: Predictor(
            capture, capture.sequence("a"), Settings(spacing, workers=1, integrator=integrator)
        )
        for integrator in (EXPLICIT, IMPLICIT)
    }
    step: dict[str, list[float]] = {name: [] for name in predictors}
    for _ in range(options.rounds):
        for integrator, predictor in predictors.items():
            spent, _ = timed(predictor, belief, gradient=False)
            substep = predictor.stable_substep(belief)
            step[integrator].append(spent / predictor.timeline(belief, options.frames, substep).substeps)
    explicit, implicit = (float(np.median(step[name])) for name in (EXPLICIT, IMPLICIT))
    transfer = predictors[IMPLICIT].transfer
    return (
        f"| {name} | {3 * len(transfer.places_at_rest())} | {1e6 * explicit:.0f} | {1e3 * implicit:.1f} | "
        f"{implicit / explicit:.0f} | {transfer.implicit_cost:.0f} |"
    )


def main() -> int:
    """Print the table."""
    options = tyro.cli(Options, config=(tyro.conf.FlagCreatePairsOff,))
    if options.bodies:
        heads = (
            "body", "unknowns", "explicit substep [us]", "implicit step [ms]", "ratio",
            "ratio that auto counts with",
        )  # fmt: skip
        print(f"| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
        for body in BODIES:
            print(body_row(*body, options), flush=True)
        return 0
    heads = (
        "E [Pa]", "explicit substeps in an implicit step", "explicit [s]", "implicit [s]", "ratio",
        "explicit, with gradient [s]", "implicit, with gradient [s]", "ratio", "error, explicit [um]",
        "error, implicit [um]", "auto takes",
    )  # fmt: skip
    print(f"| {' | '.join(heads)} |\n|{' --- |' * len(heads)}")
    for modulus in options.moduli:
        print(row(modulus, options), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
