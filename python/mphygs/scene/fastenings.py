"""Where sheets are fastened, and the shorter cells that they have there.

Where a sheet is fastened over a part of its width it bends about that, which cells as long as the joint is
wide cannot show. Petals 20 mm wide and fastened over 5 mm swing a third too fast on cells of 7 mm, and an
eighth on 4 mm. With four cells across the joint and longer ones away from it, fewer in all than the latter
are, they are within 4 % (`benchmarks/thin/joint.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from mphygs.capture.meshes import Part
from mphygs.scene.joints import Joint, find_joints
from mphygs.scene.middle_surface import MiddleSurface, middle_surface

# Cells across a fastening on the grid of default spacing, and what a cell's length grows by for each length
# away from it. Where neighbours differ by more than that, by four fifths say, the petal above is off again.
ACROSS, GROWTH = 4.0, 0.5
# Places that a stretched axis is told at.
_PLACES = 4096


class Fastening(NamedTuple):
    """low, high: (2,) bounds in the coordinates of the sheet's middle surface [m]; width: side of the longer
    two of a rectangle of the same second moments [m]."""

    low: np.ndarray
    high: np.ndarray
    width: float


@dataclass(frozen=True, eq=False)
class Grading:
    """How long cells of a sheet are.

    usual: default spacing of the object [m]; fastened: places where the sheet is; least: its thickness, below
    which no cell of that grid is [m]. On other grids cells at a fastening are as much shorter or longer as
    all are, so that what changes from grid to grid tells the error there too.
    """

    usual: float
    fastened: tuple[Fastening, ...]
    least: float

    def length(self, axis: int, x: np.ndarray, spacing: float) -> np.ndarray:
        """(n,) of cells along one axis at coordinates (n,), on a grid of a spacing [m]."""
        found = np.full(np.shape(x), spacing)
        for one in self.fastened:
            away = np.maximum(np.maximum(one.low[axis] - x, x - one.high[axis]), 0.0)
            there = spacing / self.usual * max(one.width / ACROSS, self.least)
            found = np.minimum(found, there + GROWTH * away)
        return found

    def stretched(self, axis: int, low: float, high: float, spacing: float) -> Stretched:
        """An axis between two coordinates in which all cells are as long as the spacing [m]."""
        x = np.linspace(low, high, _PLACES)
        rate = spacing / self.length(axis, x, spacing)
        along = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(x))])
        return Stretched(x, low + along, rate[0], rate[-1])

    def times(self, surface: MiddleSurface, spacing: float) -> float:
        """Cells of a sheet over those that it would have were all as long as the spacing [m]."""
        low, high = surface.flat.min(axis=0), surface.flat.max(axis=0)
        ends = [self.stretched(a, low[a], high[a], spacing).values[[0, -1]] for a in range(2)]
        return float(np.prod(np.diff(ends, axis=1)[:, 0] / (high - low)))


class Stretched(NamedTuple):
    """A monotone function told at places; beyond them it goes on straight. before, after: slopes there."""

    places: np.ndarray
    values: np.ndarray
    before: float
    after: float

    def __call__(self, x: np.ndarray) -> np.ndarray:
        x = np.asarray(x, float)
        inner = np.interp(x, self.places, self.values)
        short, over = np.minimum(x - self.places[0], 0.0), np.maximum(x - self.places[-1], 0.0)
        return inner + self.before * short + self.after * over


def fastening(surface: MiddleSurface, points: np.ndarray) -> Fastening:
    """Where points (Q, 3) on a sheet lie [m]."""
    flat = surface.flat[cKDTree(surface.place).query(points)[1]]
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[0]
    return Fastening(flat.min(axis=0), flat.max(axis=0), float(spread * np.sqrt(12.0 / len(points))))


def grading(
    parts: Sequence[Part], number: int, usual: float, gripped: Sequence[np.ndarray] = ()
) -> Grading | None:
    """Of one part, as a sheet; None where it has no two sides, or no place that asks for shorter cells.

    usual: default spacing of the object [m]; gripped: for each hold places (n, 3) where it grips the part.
    """
    try:
        surface = middle_surface_of(parts[number])
    except ValueError:  # said where it is laid
        return None
    joints = [joint.points for joint in _joints(tuple(parts)) if number in joint.parts]
    places = [*joints, *(points for points in gripped if len(points))]
    least = float(np.median(surface.thickness))
    found = [fastening(surface, points) for points in places]
    # One that is narrower than the widest one's cells are long carries little beside it: meshes that overlap
    # touch at many small places.
    carries = max((one.width for one in found), default=0.0) / ACROSS
    shorter = tuple(one for one in found if one.width > carries and max(one.width / ACROSS, least) < usual)
    return Grading(usual, shorter, least) if shorter else None


@lru_cache(maxsize=256)
def middle_surface_of(part: Part) -> MiddleSurface:
    """As `middle_surface`, kept."""
    return middle_surface(part)


@lru_cache(maxsize=64)
def _joints(parts: tuple[Part, ...]) -> tuple[Joint, ...]:
    """Of all parts. Where they touch depends on no grid: so finely as tells how wide the usual joint is."""
    side = float(np.median([np.sqrt(part.area / 2.0) for part in parts]))
    return tuple(find_joints(parts, spacing=side / 2.0))
