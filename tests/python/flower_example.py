"""A small flower that the tests of synth.flower make in seconds: coarse grid, few and small pictures."""

from __future__ import annotations

from pathlib import Path

from mphygs.synth.flower import Shoot, make_flower
from mphygs.synth.make import Made

SMALL = Shoot(size=64, rest_views=8, cameras=3, frames=8, tracks=40, spacing_share=1.6)


def small_flower(folder: Path, *, species: str = "daisy", seed: int = 1, **options: object) -> Made:
    """A flower of eight frames and 64 x 64 pixels, written to `folder`."""
    return make_flower(species, folder, seed=seed, shoot=SMALL, **options)
