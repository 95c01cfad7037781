"""How a hand moves a flower: smooth reaches and turns, a slight tremor, and the stop in a flower frog."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.capture.motions import HoldMovement
from mphygs.synth.recipe import Take

FPS = 50.0
# Length of a motion as it is meant [s].
USUAL = 2.0
# The two recorded motions.
TAKES = ("frog", "turned")


def hand_takes(frames: int, seed: int, *, fps: float = FPS) -> tuple[Take, ...]:
    """Two motions of the hand that holds a stem, each of `frames` frames, all different from seed to seed.

    frog: carried over, tilted on the way, set upright and pushed down onto a frog's pins, where it stops
    short. turned: lifted, turned about the stem, and shaken lightly. The first is for fitting on its first
    half and for prediction up to 8 tenths of it, the second for prediction only. Both last as long as the
    frames do; where that is less than two seconds they go less far.
    """
    generator = np.random.default_rng([seed, 13])
    length = frames / fps
    size = min(1.0, length / USUAL) ** 1.5
    half, most = round(0.5 * frames), round(0.8 * frames)
    takes = []
    for name, motions, fit, predict in (
        (TAKES[0], _into_the_frog(length, size, generator), (0, half), (half, most)),
        (TAKES[1], _turned(length, size, generator), (0, 0), (0, frames)),
    ):
        takes.append(Take(name, tuple(motions), fps, frames, fit, predict))
    return tuple(takes)


def _into_the_frog(length: float, size: float, generator: np.random.Generator) -> Sequence[HoldMovement]:
    way, axis, turn = _directions(generator)
    far = size * generator.uniform(0.026, 0.036)
    high, deep = size * generator.uniform(0.014, 0.020), size * generator.uniform(0.020, 0.026)
    tilt = size * generator.uniform(9.0, 14.0)
    return (
        HoldMovement("shift", 0.02 * length, 0.30 * length, by=(0.0, 0.0, high)),
        HoldMovement("shift", 0.08 * length, 0.48 * length, by=tuple(far * way)),
        HoldMovement("turn", 0.04 * length, 0.28 * length, axis=tuple(axis), degrees=tilt),
        HoldMovement("turn", 0.34 * length, 0.56 * length, axis=tuple(axis), degrees=-tilt),
        HoldMovement("turn", 0.10 * length, 0.50 * length, axis=(0.0, 0.0, 1.0), degrees=35.0 * size * turn),
        # Quick, and ended by the pins.
        HoldMovement("shift", 0.56 * length, 0.66 * length, by=(0.0, 0.0, -deep)),
        _tremor(0.05 * length, 0.56 * length, generator),
    )


def _turned(length: float, size: float, generator: np.random.Generator) -> Sequence[HoldMovement]:
    way, axis, turn = _directions(generator)
    far = size * generator.uniform(0.006, 0.009)
    return (
        HoldMovement(
            "shift", 0.02 * length, 0.35 * length, by=(0.0, 0.0, size * generator.uniform(0.014, 0.022))
        ),
        HoldMovement("turn", 0.05 * length, 0.50 * length, axis=(0.0, 0.0, 1.0), degrees=50.0 * size * turn),
        HoldMovement(
            "shake", 0.30 * length, 0.85 * length, by=tuple(far * way), ramp=0.2 * length,
            frequency=float(generator.uniform(1.4, 2.0)) * USUAL / length,
        ),
        HoldMovement(
            "rock", 0.25 * length, 0.95 * length, axis=tuple(axis), ramp=0.2 * length,
            degrees=size * float(generator.uniform(4.0, 6.0)),
            frequency=float(generator.uniform(0.9, 1.3)) * USUAL / length,
        ),
        _tremor(0.05 * length, 0.95 * length, generator),
    )  # fmt: skip


def _directions(generator: np.random.Generator) -> tuple[np.ndarray, np.ndarray, float]:
    """A level direction to move in, the level axis to tilt about in that direction, and which way to turn."""
    bearing = generator.uniform(0.0, 2.0 * np.pi)
    way = np.array([np.cos(bearing), np.sin(bearing), 0.0])
    return way, np.array([-way[1], way[0], 0.0]), float(generator.choice([-1.0, 1.0]))


def _tremor(start: float, stop: float, generator: np.random.Generator) -> HoldMovement:
    by = 3e-4 * generator.standard_normal(3)
    ramp = 0.3 * (stop - start)
    return HoldMovement(
        "shake", start, stop, by=tuple(by), frequency=float(generator.uniform(6.0, 8.0)), ramp=ramp
    )
