"""Small recipes that the tests of synth make in a moment: coarse, short, few markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from mphygs.capture.format import Capture, load_capture
from mphygs.capture.motions import HoldMovement
from mphygs.synth.make import Made, make_capture
from mphygs.synth.marker_noise import Noise
from mphygs.synth.recipe import Recipe, Take, recipe

SIGMA = 2e-4


def small(
    kind: str, hidden: tuple[str, ...] = (), *, frames: int = 24, seed: int = 3, **options: object
) -> Recipe:
    """A recipe of one short take on a coarse grid."""
    fps, release = (60.0, 2) if "bar" in kind else (30.0, None)
    moved = (HoldMovement("shake", 0.05, 0.35, by=(0.004, 0.006, 0.003), frequency=4.0, ramp=0.12),)
    take = Take("a", moved, fps, frames, (0, frames), (0, 0), release)
    settings: dict[str, object] = {
        "spacing_share": 1.4,
        "marker_count": 24,
        "noise": Noise(sigma=SIGMA),
    } | options
    if settings.pop("noise_free", False):
        settings["noise"] = Noise(sigma=1e-9, dropout=0.0)
    return recipe(kind, hidden=hidden, seed=seed, takes=(take,), **settings)


def made(
    folder: Path, *arguments: object, measure_signal: bool = False, **options: object
) -> tuple[Made, Capture]:
    """The small recipe, written and read back."""
    result = make_capture(small(*arguments, **options), folder, measure_signal=measure_signal)
    return result, load_capture(folder)


def tracks(capture: Capture) -> np.ndarray:
    """(T, M, 3) [m] of the only sequence."""
    markers = capture.sequences[0].markers
    assert markers is not None
    return markers.position
