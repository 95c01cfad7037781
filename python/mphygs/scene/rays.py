"""Where vertical lines cross a closed triangle mesh, for many lines at once, and what follows from it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# Most (triangle, ray) pairs looked at together: bounds the memory to a few hundred megabytes.
_PAIRS_AT_ONCE = 1 << 20
# Slopes of the lines `inside` shoots. Irrational, so that lines from points on a lattice miss the edges of
# meshes built on the same lattice.
_TILT = np.array([np.sqrt(2.0) - 1.0, np.sqrt(3.0) - 1.0]) * 1e-2


def expand(counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Row number and place within the row for rows of the given lengths, laid end to end.

    counts: (N,) int -> row (sum,), place (sum,), both int64.
    """
    counts = np.asarray(counts, dtype=np.int64)
    row = np.repeat(np.arange(len(counts)), counts)
    place = np.arange(len(row)) - np.repeat(np.cumsum(counts) - counts, counts)
    return row, place


class _RayBins:
    """Rays sorted into a plane lattice of bins, so that a triangle meets only the rays near it."""

    def __init__(self, rays: np.ndarray) -> None:
        self.low = rays.min(axis=0)
        extent = rays.max(axis=0) - self.low
        side = max(np.sqrt(extent[0] * extent[1] * 4.0 / len(rays)), extent.max() / len(rays))
        self.side = side if side > 0.0 else 1.0
        self.shape = np.floor(extent / self.side).astype(np.int64) + 1
        place = self.bin_of(rays)
        number = place[:, 0] * self.shape[1] + place[:, 1]
        self.order = np.argsort(number, kind="stable")
        self.start = np.concatenate([[0], np.cumsum(np.bincount(number, minlength=self.shape.prod()))])

    def bin_of(self, points: np.ndarray) -> np.ndarray:
        return np.clip(np.floor((points - self.low) / self.side).astype(np.int64), 0, self.shape - 1)

    def pairs(self, low: np.ndarray, high: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Chunks of (triangle, ray) pairs whose bins overlap; low, high: (F, 2) boxes of the triangles."""
        first, last = self.bin_of(low), self.bin_of(high)
        # Bins of one column are neighbours in the sorted order, so a triangle meets one run of rays a column.
        triangle, place = expand(last[:, 0] - first[:, 0] + 1)
        column = (first[triangle, 0] + place) * self.shape[1]
        begin = self.start[column + first[triangle, 1]]
        count = self.start[column + last[triangle, 1] + 1] - begin
        chunk = np.cumsum(count) // _PAIRS_AT_ONCE
        for bounds in np.split(np.arange(len(count)), np.flatnonzero(np.diff(chunk)) + 1):
            row, place = expand(count[bounds])
            yield triangle[bounds][row], self.order[begin[bounds][row] + place]


def _side(a: np.ndarray, b: np.ndarray, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Twice the signed area of (a, b, p) and its sign as a bool, never undecided.

    Both triangles at an edge evaluate it from the same end, so their answers are exact opposites and no ray
    slips between them or hits both.
    """
    swapped = (b[:, 0] < a[:, 0]) | ((b[:, 0] == a[:, 0]) & (b[:, 1] < a[:, 1]))
    from_, to = np.where(swapped[:, None], b, a), np.where(swapped[:, None], a, b)
    along, across = to - from_, p - from_
    area = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    return np.where(swapped, -area, area), (area >= 0.0) ^ swapped


def crossings(vertices: np.ndarray, faces: np.ndarray, rays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Heights at which lines along z cross a triangle mesh.

    vertices: (V, 3) [m]; faces: (F, 3) int; rays: (R, 2) x and y of each line [m].
    Returns the ray of each crossing (K,) int64 and its height (K,) [m], in no particular order.
    """
    if len(rays) == 0 or len(faces) == 0:
        return np.empty(0, dtype=np.int64), np.empty(0)
    corners = vertices[faces]  # (F, 3, 3)
    low, high = corners.min(axis=1), corners.max(axis=1)
    near = np.all((high[:, :2] >= rays.min(axis=0)) & (low[:, :2] <= rays.max(axis=0)), axis=1)
    corners, low, high = corners[near], low[near], high[near]
    found_rays, found_heights = [np.empty(0, dtype=np.int64)], [np.empty(0)]
    for triangle, ray in _RayBins(rays).pairs(low[:, :2], high[:, :2]):
        point = rays[ray]
        close = np.all((point >= low[triangle, :2]) & (point <= high[triangle, :2]), axis=1)
        triangle, ray, point = triangle[close], ray[close], point[close]
        a, b, c = (corners[triangle, k] for k in range(3))
        weight_c, side_c = _side(a[:, :2], b[:, :2], point)
        weight_a, side_a = _side(b[:, :2], c[:, :2], point)
        weight_b, side_b = _side(c[:, :2], a[:, :2], point)
        hit = (side_a == side_b) & (side_b == side_c)
        weights = np.stack([weight_a, weight_b, weight_c], axis=1)[hit]
        total = weights.sum(axis=1)
        flat = total == 0.0  # an upright triangle met edge-on: any height on it will do
        weights[flat], total[flat] = 1.0, 3.0
        heights = np.stack([a[hit, 2], b[hit, 2], c[hit, 2]], axis=1)
        height = (weights * heights).sum(axis=1) / total
        found_rays.append(ray[hit])
        found_heights.append(np.clip(height, heights.min(axis=1), heights.max(axis=1)))
    return np.concatenate(found_rays), np.concatenate(found_heights)


def inside(part: Part, points: np.ndarray) -> np.ndarray:
    """Whether points lie inside a closed mesh, by the parity of crossings above them.

    points: (N, 3) [m] -> (N,) bool. A point on the surface itself may come out either way.
    Raises ValueError if points is not a finite (N, 3) array.
    """
    points = checked_points(points, "points")
    result = np.zeros(len(points), dtype=bool)
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    candidate = np.flatnonzero(np.all((points >= low) & (points <= high), axis=1))
    if len(candidate) == 0:
        return result
    # Slanted rays are vertical ones in sheared axes; z is kept.
    vertices, targets = np.array(part.vertices), points[candidate]
    vertices[:, :2] -= vertices[:, 2:] * _TILT
    rays = targets[:, :2] - targets[:, 2:] * _TILT
    ray, height = crossings(vertices, part.faces, rays)
    above = np.bincount(ray[height > targets[ray, 2]], minlength=len(candidate))
    result[candidate] = above % 2 == 1
    return result


def checked_points(points: np.ndarray, name: str) -> np.ndarray:
    """The points as a finite (N, 3) float64 array. Raises ValueError naming them otherwise."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name}: expected an (N, 3) array, got shape {array.shape}")
    if not np.all(np.isfinite(array)):
        row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise ValueError(f"{name}: row {row} is not finite, expected three numbers in metres")
    return array


def checked_boxes(boxes: np.ndarray | None, name: str) -> np.ndarray:
    """The boxes as an (H, 2, 3) float64 array, none as H = 0. Raises ValueError naming them otherwise."""
    if boxes is None:
        return np.empty((0, 2, 3))
    array = np.asarray(boxes, dtype=np.float64)
    if array.size == 0:
        return np.empty((0, 2, 3))
    if array.ndim != 3 or array.shape[1:] != (2, 3):
        raise ValueError(f"{name}: expected an (H, 2, 3) array of corners, got shape {array.shape}")
    wrong = np.flatnonzero(~(array[:, 1] >= array[:, 0]).all(axis=1))
    if len(wrong):
        box = array[wrong[0]].tolist()
        raise ValueError(f"{name}: box {int(wrong[0])} needs its lower corner first, got {box}")
    return array
