"""Where a hold grips: the cross-sections through which held material passes into free material."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from mphygs.scene.columns import cut_axis, flat_planes
from mphygs.scene.rays import checked_boxes, inside

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# A sheet has so many across its thickness: where it is gripped it may not turn about the line of its grip.
SAMPLES_PER_SPACING, ACROSS = 6, 4
# Points on one part's section.
_MOST = 1 << 20
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

    box: (2, 3) [m]; spacing: of the grid [m], points lie about spacing / 6 apart, on rods and shells near
    enough for some across their thickness; other_boxes: (H, 2, 3) [m], further holds: material that is held
    on the other side of the face as well does not count as going on.
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
    if all(part.shape == "solid" for part in parts):
        regions = [(low, high, None)]
    else:
        regions = [(low, high, number) for number in range(len(parts))]
    faces = []
    for axis in range(3):
        across = [other for other in range(3) if other != axis]
        for end, outward in ((0, -1.0), (1, 1.0)):
            coordinate = float(box[end, axis])
            found = [
                face
                for region in regions
                if (face := _crossed(parts, others, axis, across, coordinate, outward, spacing, *region))
            ]
            if found:
                points, area, owner = (np.concatenate(values) for values in zip(*found, strict=True))
                faces.append(HoldFace(axis, coordinate, points, area, owner))
    return faces


def _step(part: Part, spacing: float, axis: int, coordinate: float) -> float:
    """How far apart a part's samples on a plane may lie: a section that is thin has some across. One along a
    sheet is as wide as the sheet."""
    usual = spacing / SAMPLES_PER_SPACING
    if part.shape == "solid":
        return usual
    thickness = max(2.0 * part.volume / part.area, _section_thickness(part, axis, coordinate))
    return min(usual, thickness / ACROSS)


def _crossed(
    parts: Sequence[Part],
    others: np.ndarray,
    axis: int,
    across: list[int],
    coordinate: float,
    outward: float,
    spacing: float,
    low: np.ndarray,
    high: np.ndarray,
    number: int | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """Points, areas and parts where material crosses a plane between low and high, of one part or of all."""
    step = spacing / SAMPLES_PER_SPACING
    if number is not None:
        section = _section_bounds(parts[number], axis, coordinate)
        if section is None:
            return None
        low, high = np.maximum(low, section[0]), np.minimum(high, section[1])
        if not np.all(high[across] > low[across]):
            return None
        step = _step(parts[number], spacing, axis, coordinate)
        step = max(step, float(np.sqrt((high - low)[across].prod() / _MOST)))
    points, area = _grid(parts, others, low, high, across, step)
    points[:, axis] = coordinate
    beyond = np.zeros(3)
    beyond[axis] = outward * _PROBE * spacing
    owner = _owner(parts, points + beyond)
    crossed = (_owner(parts, points - beyond) >= 0) & (owner >= 0)
    if number is not None:
        crossed &= owner == number
    for other in others:
        crossed &= ~np.all((points + beyond > other[0]) & (points + beyond < other[1]), axis=1)
    return (points[crossed], area[crossed], owner[crossed]) if crossed.any() else None


def _section_bounds(part: Part, axis: int, coordinate: float) -> np.ndarray | None:
    """(2, 3) corners of a box around where a mesh meets a plane, unbounded along the plane's axis."""
    corners = part.vertices[part.faces]
    side = corners[:, :, axis] - coordinate
    met = (side.min(axis=1) <= 0.0) & (side.max(axis=1) >= 0.0)
    places = []
    for k in range(3):
        a, b = side[met, k], side[met, (k + 1) % 3]
        cut = (np.minimum(a, b) <= 0.0) & (np.maximum(a, b) >= 0.0) & (a != b)
        share = a[cut] / (a - b)[cut]
        one, two = corners[met, k][cut], corners[met, (k + 1) % 3][cut]
        places.append(one + share[:, None] * (two - one))
    place = np.concatenate(places)
    if not len(place):
        return None
    bounds = np.stack([place.min(axis=0), place.max(axis=0)])
    bounds[:, axis] = -np.inf, np.inf
    return bounds


def _section_thickness(part: Part, axis: int, coordinate: float) -> float:
    """Twice the area of a mesh's section with a plane over its outline's length [m], 0 without one."""
    corners = part.vertices[part.faces]
    above = corners[:, :, axis] >= coordinate
    corners, above = corners[above.any(axis=1) & ~above.all(axis=1)], above[above.any(1) & ~above.all(1)]
    if not len(corners):
        return 0.0
    after, row = np.roll(corners, -1, axis=1), np.arange(len(corners))
    crossing = above ^ np.roll(above, -1, axis=1)
    # The outline goes through a triangle from where its edges rise through the plane to where they sink.
    outline = []
    for way in (crossing & ~above, crossing & above):
        edge = np.argmax(way, axis=1)
        a, b = corners[row, edge], after[row, edge]
        share = (coordinate - a[:, axis]) / (b - a)[:, axis]
        outline.append(np.delete(a + share[:, None] * (b - a), axis, axis=1))
    begin, end = outline
    about = begin.mean(axis=0)
    (x, y), (dx, dy) = (begin - about).T, (end - begin).T
    return float(np.abs((x * dy - y * dx).sum()) / np.hypot(dx, dy).sum())


def _grid(
    parts: Sequence[Part],
    others: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    across: list[int],
    step: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Midpoints and areas of rectangles, no wider than a step, that tile [low, high] along two axes."""
    strips = []
    for axis in across:
        length = float(high[axis] - low[axis])
        samples = int(np.ceil(length / step - 1e-6))
        flat = np.unique(np.concatenate([flat_planes(part, axis, 1e-9 * step) for part in parts]))
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
