"""The spacing of a grid of which an object is worth so many cells."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

from mphygs.capture.meshes import Part
from mphygs.scene.curved_quadrature import cell_count, chosen_shape
from mphygs.scene.fastenings import Grading, grading

# Cells that an object of default spacing is worth: about 250 of its volume, and of its sheets and rods.
DEFAULT_CELLS = 250


def usual_spacing(parts: Sequence[Part]) -> float:
    """The spacing that gives parts about DEFAULT_CELLS full cells of material [m], two digits.

    Sheets that are fastened over a part of their width have shorter cells there (see `Grading`). The spacing
    is larger by the square root of how many times as many cells the object has by that: it makes up for a
    part of them, for there are hardly fewer of the shorter ones on a coarser grid.
    """
    return _usual_spacing(tuple(parts))


@lru_cache(maxsize=64)
def _usual_spacing(parts: tuple[Part, ...]) -> float:
    spacing = spacing_worth(parts, DEFAULT_CELLS)
    spacing *= np.sqrt(_count(parts, spacing, graded=True) / _count(parts, spacing))
    digits = 10.0 ** (np.floor(np.log10(spacing)) - 1)
    return float(np.round(spacing / digits) * digits)


def _count(parts: Sequence[Part], spacing: float, *, graded: bool = False) -> float:
    """Cells that parts are worth, with the shorter ones or without."""

    def shorter(number: int, part: Part) -> Grading | None:
        sheet = graded and chosen_shape(part, spacing)[0] == "shell"
        return grading(parts, number, spacing) if sheet else None

    return sum(cell_count(part, spacing, shorter(number, part)) for number, part in enumerate(parts))


def spacing_worth(parts: Sequence[Part], cells: float) -> float:
    """The spacing of which parts are worth so many cells [m]: of the volume of solids, of sheets and rods of
    their area and their length."""
    full = (sum(part.volume for part in parts) / cells) ** (1.0 / 3.0)
    if all(part.shape == "solid" for part in parts):
        return full

    def excess(spacing: float) -> float:
        return float(np.log(_count(parts, spacing) / cells))

    # A sheet of cells thicker than it is worth more of them than its volume: this is the finest it can be.
    high = full
    while excess(high) > 0.0:
        high *= 2.0
    return high if high == full else float(brentq(excess, 0.5 * high, high, rtol=1e-3))
