"""Spacings of the grid: the default of an object, those for trying models and for deciding between them."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

from mphygs.capture.format import Capture
from mphygs.scene.particles import cell_count

# Cells that an object of default spacing is worth: about 250 of its volume, and of its sheets and rods.
DEFAULT_CELLS = 250
# Cells of material, eight points each, that tens of gigabytes hold.
MOST_CELLS = 2e6
# Of the default spacing: where many models are tried, and where those that are left are decided between.
SCREENING_FACTOR, DECIDING_FACTOR = 1.7, 1.28
# A grid within this factor of the deciding one is no screening grid.
FINE = 1.1


def default_spacing(capture: Capture) -> float:
    """Grid spacing that gives about DEFAULT_CELLS full cells of material [m], two digits."""
    spacing = _worth(capture, DEFAULT_CELLS)
    digits = 10.0 ** (np.floor(np.log10(spacing)) - 1)
    return float(np.round(spacing / digits) * digits)


def _worth(capture: Capture, cells: float) -> float:
    """The spacing of which an object is worth so many cells [m]."""
    volume = sum(part.volume for part in capture.parts)
    full = (volume / cells) ** (1.0 / 3.0)
    if all(part.shape == "solid" for part in capture.parts):
        return full

    def excess(spacing: float) -> float:
        return float(np.log(sum(cell_count(part, spacing) for part in capture.parts) / cells))

    # A sheet of cells thicker than it is worth more of them than its volume: this is the finest it can be.
    high = full
    while excess(high) > 0.0:
        high *= 2.0
    return high if high == full else float(brentq(excess, 0.5 * high, high, rtol=1e-3))


def check_spacing(capture: Capture, spacing: float, where: str) -> None:
    """Raises ValueError, beginning with `where`, for a grid of more cells than fit into memory."""
    finest = _worth(capture, MOST_CELLS)
    if spacing < finest:
        raise ValueError(
            f"{where}: got {spacing:g} m; expected {finest:.2g} m or more, {MOST_CELLS:.0e} cells of material"
        )


def screening_spacing(capture: Capture) -> float:
    """Coarser spacing for trying many models one after the other [m]: a sixth of the work of the default."""
    return round(SCREENING_FACTOR * default_spacing(capture), 6)


def deciding_spacing(capture: Capture) -> float:
    """Spacing at which models are judged and decided between [m]: 0.3 to 0.6 of the work of the default."""
    return round(DECIDING_FACTOR * default_spacing(capture), 6)
