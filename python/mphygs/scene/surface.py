"""The object's surface that is open to the air, as samples with area and normal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mphygs.scene.closest import closest_on_mesh
from mphygs.scene.rays import checked_boxes, inside

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# Another part this close, in units of max_edge, is in contact.
_REACH = 1e-3


@dataclass(frozen=True)
class SurfaceSamples:
    """Points that each stand for a piece of surface.

    points: (S, 3) [m]; area: (S,) [m^2]; normal: (S, 3), unit, outward; part: (S,) int.
    """

    points: np.ndarray
    area: np.ndarray
    normal: np.ndarray
    part: np.ndarray


def exposed_surface(
    parts: Sequence[Part], *, max_edge: float, exclude_boxes: np.ndarray | None = None
) -> SurfaceSamples:
    """Samples of the surface that neither touches another part nor belongs to held material.

    max_edge: a sample stands for at most max_edge^2 [m]; exclude_boxes: (H, 2, 3) [m], held material.
    Triangles are cut where boxes (and bounding boxes of other parts) cut them, then divided evenly; each
    piece is one sample at its centroid. Dropped are pieces inside another part or within max_edge / 1000 of
    it, and pieces whose material lies in a box. The area is exact where parts are boxes along the axes or
    meet triangle by triangle; elsewhere the rim of an interface is resolved to one sample.
    Raises ValueError on a max_edge that is not positive and on malformed boxes.
    """
    boxes = checked_boxes(exclude_boxes, "exclude_boxes")
    if not (np.isfinite(max_edge) and max_edge > 0.0):
        raise ValueError(f"max_edge: got {max_edge}, expected a positive length in metres")
    reach = _REACH * max_edge
    bounds = [np.stack([part.vertices.min(axis=0), part.vertices.max(axis=0)]) for part in parts]
    pieces = []
    for number, part in enumerate(parts):
        near = [
            other
            for other in range(len(parts))
            if other != number and _overlap(bounds[number], bounds[other], reach)
        ]
        triangles = part.vertices[part.faces]
        for box in [*boxes, *(bounds[other] for other in near)]:
            triangles = cut_by_box(triangles, box, reach)
        points, area, normal = _divide(triangles, max_edge)
        kept = np.ones(len(points), dtype=bool)
        for box in boxes:
            material = points - reach * normal
            kept &= ~np.all((material > box[0]) & (material < box[1]), axis=1)
        for other in near:
            low, high = bounds[other] + np.array([[-reach], [reach]])
            close = np.all((points >= low) & (points <= high), axis=1)
            asked = np.flatnonzero(kept & close)
            kept[asked] = ~covered_by(parts[other], points[asked], normal[asked], reach)
        pieces.append((points[kept], area[kept], normal[kept], np.full(int(kept.sum()), number)))
    if not pieces:
        return SurfaceSamples(np.empty((0, 3)), np.empty(0), np.empty((0, 3)), np.empty(0, dtype=np.int64))
    return SurfaceSamples(*(np.concatenate(values) for values in zip(*pieces, strict=True)))


def _overlap(one: np.ndarray, other: np.ndarray, reach: float) -> bool:
    return bool(np.all(one[0] <= other[1] + reach) and np.all(other[0] <= one[1] + reach))


def covered_by(part: Part, points: np.ndarray, normal: np.ndarray, reach: float) -> np.ndarray:
    """Whether material of a part lies on the points or just outside of them."""
    covered = inside(part, points + reach * normal)
    rest = np.flatnonzero(~covered)
    covered[rest] = closest_on_mesh(part.vertices, part.faces, points[rest])[1] <= reach
    return covered


def cut_by_box(triangles: np.ndarray, box: np.ndarray, reach: float) -> np.ndarray:
    """The same surface with no triangle reaching across a face of the box; triangles (T, 3, 3).

    Triangles that stop short of the box by less than reach [m] are cut as well.
    """
    for axis in range(3):
        for end in range(2):
            low, high = triangles.min(axis=1), triangles.max(axis=1)
            met = np.all((high >= box[0] - reach) & (low <= box[1] + reach), axis=1)
            cut = cut_by_plane(triangles[met], axis, float(box[end, axis]), 1e-6 * reach)
            triangles = np.concatenate([triangles[~met], cut])
    return triangles


def cut_by_plane(triangles: np.ndarray, axis: int, coordinate: float, tolerance: float) -> np.ndarray:
    """The same surface with no triangle reaching across a plane; triangles (T, 3, 3); corners within
    tolerance [m] are on it."""
    height = triangles[:, :, axis] - coordinate
    height = np.where(np.abs(height) <= tolerance, 0.0, height)
    above, below = (height > 0.0).sum(axis=1), (height < 0.0).sum(axis=1)
    crossed = (above > 0) & (below > 0)
    whole, triangles, height = triangles[~crossed], triangles[crossed], height[crossed]
    # Turn each so that its first corner is the one alone on its side of the plane.
    sign = np.where(above[crossed] == 1, 1.0, -1.0)
    turn = (np.argmax(height * sign[:, None] > 0.0, axis=1)[:, None] + np.arange(3)) % 3
    rows = np.arange(len(triangles))[:, None]
    triangles, height = triangles[rows, turn], height[rows, turn]
    tip, left, right = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    on_left = tip + (height[:, 0] / (height[:, 0] - height[:, 1]))[:, None] * (left - tip)
    on_right = tip + (height[:, 0] / (height[:, 0] - height[:, 2]))[:, None] * (right - tip)
    return np.concatenate(
        [
            whole,
            np.stack([tip, on_left, on_right], axis=1),
            np.stack([on_left, left, right], axis=1),
            np.stack([on_left, right, on_right], axis=1),
        ]
    )


def _divide(triangles: np.ndarray, max_edge: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centroid, area and normal of n^2 equal pieces of each triangle, none larger than max_edge^2."""
    first, second = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    cross = np.cross(first, second)
    double = np.linalg.norm(cross, axis=1)
    real = double > 1e-18 * max_edge**2  # cuts through a corner leave triangles of no area
    triangles, first, second, cross, double = (
        values[real] for values in (triangles, first, second, cross, double)
    )
    count = np.maximum(np.ceil(np.sqrt(0.5 * double) / max_edge - 1e-9), 1).astype(np.int64)
    points, area, normal = [np.empty((0, 3))], [np.empty(0)], [np.empty((0, 3))]
    for n in np.unique(count):
        row = np.flatnonzero(count == n)
        u, v = _centroids(int(n))
        start = triangles[row, 0][:, None]
        place = start + u[:, None] * first[row][:, None] + v[:, None] * second[row][:, None]
        points.append(place.reshape(-1, 3))
        area.append(np.repeat(0.5 * double[row] / n**2, n**2))
        normal.append(np.repeat(cross[row] / double[row][:, None], n**2, axis=0))
    return np.concatenate(points), np.concatenate(area), np.concatenate(normal)


def _centroids(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Shares of the two edges at the centroids of the n^2 equal pieces of a triangle."""
    i, j = (values.ravel() for values in np.meshgrid(np.arange(n), np.arange(n), indexing="ij"))
    upright, inverted = i + j < n, i + j < n - 1
    u = np.concatenate([i[upright] + 1.0 / 3.0, i[inverted] + 2.0 / 3.0]) / n
    v = np.concatenate([j[upright] + 1.0 / 3.0, j[inverted] + 2.0 / 3.0]) / n
    return u, v
