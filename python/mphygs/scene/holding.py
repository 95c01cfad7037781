"""Where a hold grips: the cross-sections through which held material passes into free material."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mphygs.scene.columns import cut_axis, flat_planes
from mphygs.scene.rays import checked_boxes, inside

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# So many at least across what is thin: a sheet that is gripped may not turn about the line of its grip.
SAMPLES_PER_SPACING, FEWEST = 6, 4
# How far to either side of the face there must be material, in spacings.
_PROBE = 1e-3


class HoldFace(NamedTuple):
    """One face of a hold's box, where material crosses it.

    axis: the face is square to it; coordinate: along that axis [m]; points: (n, 3), on the face [m];
    area: (n,), what each point stands for [m^2]; part: (n,), the first part that goes on there.
    """

    axis: int
    coordinate: float
    points: np.ndarray
    area: np.ndarray
    part: np.ndarray


def hold_face(
    parts: Sequence[Part], box: np.ndarray, *, spacing: float, other_boxes: np.ndarray | None = None
) -> list[HoldFace]:
    """Cross-sections of the union of the parts with the six faces of a box, where material goes on outside.

    box: (2, 3) [m]; spacing: of the grid [m], points lie about spacing / 6 apart; other_boxes: (H, 2, 3) [m],
    further holds: material that is held on the other side of the face as well does not count as going on.
    A face counts where there is material just inside and just outside the box, so one that lies on the
    object's own surface, or beyond it, is left out. Areas are exact for sections with sides along the axes.
    Returns the faces of positive area, lower before upper, in the order of the axes.
    Raises ValueError on a malformed or flat box and on a spacing that is not positive.
    """
    (box,) = checked_boxes(np.asarray(box)[None], "box")
    others = checked_boxes(other_boxes, "other_boxes")
    if not np.all(box[1] > box[0]):
        raise ValueError(f"box: expected a positive extent along every axis, got {box.tolist()}")
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise ValueError(f"spacing: got {spacing}, expected a positive length in metres")
    vertices = np.concatenate([part.vertices for part in parts])
    low, high = np.maximum(box[0], vertices.min(axis=0)), np.minimum(box[1], vertices.max(axis=0))
    if not np.all(high > low):
        return []
    faces = []
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        points, area = _grid(parts, others, low, high, across, spacing)
        for end, outward in ((0, -1.0), (1, 1.0)):
            points[:, axis] = box[end, axis]
            step = np.zeros(3)
            step[axis] = outward * _PROBE * spacing
            owner = _owner(parts, points + step)
            crossed = (_owner(parts, points - step) >= 0) & (owner >= 0)
            for other in others:
                crossed &= ~np.all((points + step > other[0]) & (points + step < other[1]), axis=1)
            if crossed.any():
                coordinate = float(box[end, axis])
                faces.append(HoldFace(axis, coordinate, points[crossed], area[crossed], owner[crossed]))
    return faces


def _grid(
    parts: Sequence[Part],
    others: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    across: list[int],
    spacing: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Midpoints and areas of rectangles that tile [low, high] along the two axes across."""
    strips = []
    for axis in across:
        length = float(high[axis] - low[axis])
        samples = max(int(np.ceil(length / spacing * SAMPLES_PER_SPACING - 1e-6)), FEWEST)
        flat = np.unique(np.concatenate([flat_planes(part, axis, 1e-9 * spacing) for part in parts]))
        flat = flat if len(flat) <= max(samples, 8) else flat[:0]
        planes = np.concatenate([flat, others[:, :, axis].ravel()])
        strips.append(cut_axis(float(low[axis]), length, 1, samples, planes))
    points = np.zeros((len(strips[0].low) * len(strips[1].low), 3))
    points[:, across[0]] = np.repeat(strips[0].middle, len(strips[1].low))
    points[:, across[1]] = np.tile(strips[1].middle, len(strips[0].low))
    return points, np.outer(strips[0].width, strips[1].width).ravel()


def _owner(parts: Sequence[Part], points: np.ndarray) -> np.ndarray:
    """(n,) the first part that has each point, -1 where none does."""
    found = np.full(len(points), -1)
    for number, part in enumerate(parts):
        asked = np.flatnonzero(found < 0)
        found[asked[inside(part, points[asked])]] = number
    return found
