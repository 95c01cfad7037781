"""Spacings of the grid: the default of an object, those for trying models and for deciding between them."""

from __future__ import annotations

from mphygs.capture.format import Capture
from mphygs.scene.spacing_worth import spacing_worth, usual_spacing

# Cells of material, eight points each, that tens of gigabytes hold.
MOST_CELLS = 2e6
# Of the default spacing: where many models are tried, and where those that are left are decided between.
SCREENING_FACTOR, DECIDING_FACTOR = 1.7, 1.28
# A grid within this factor of the deciding one is no screening grid.
FINE = 1.1


def default_spacing(capture: Capture) -> float:
    """Grid spacing that gives about 250 full cells of material [m], two digits."""
    return usual_spacing(capture.parts)


def check_spacing(capture: Capture, spacing: float, where: str) -> None:
    """Raises ValueError, beginning with `where`, for a grid of more cells than fit into memory."""
    finest = spacing_worth(capture.parts, MOST_CELLS)
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
