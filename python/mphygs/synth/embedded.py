"""The capture that is there without any data: small, made in seconds, with something hidden in it."""

from __future__ import annotations

from pathlib import Path

from mphygs.capture.motions import HoldMovement
from mphygs.synth.make import make_capture
from mphygs.synth.marker_noise import Noise
from mphygs.synth.recipe import Take, recipe


def embedded_capture(folder: str | Path) -> Path:
    """Write the embedded capture to `folder` and return that path; one that is complete is kept.

    A bar of two materials, released under gravity and shifted, with viscosity hidden in it; answer.json
    holds the truth. A second motion, a shake, is there for prediction only.
    """
    folder = Path(folder)
    if (folder / "answer.json").is_file():
        return folder
    shift = (HoldMovement("shift", 0.08, 0.33, by=(0.0, 0.018, 0.009)),)
    shake = (HoldMovement("shake", 0.08, 0.75, by=(0.0, 0.004, 0.004), frequency=4.0, ramp=0.2),)
    takes = (
        Take("release", shift, 60.0, 48, (0, 30), (30, 48), release=2),
        Take("shake", shake, 60.0, 48, (0, 0), (0, 48), release=2),
    )
    made = recipe(
        "two-part-bar",
        hidden=("viscosity:eta=60",),
        name="embedded",
        noise=Noise(sigma=2e-4),
        marker_count=60,
        takes=takes,
        seed=7,
        spacing_share=0.8,
        known="densities",
    )
    make_capture(made, folder, measure_signal=False)
    return folder
