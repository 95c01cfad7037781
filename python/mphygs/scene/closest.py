"""The closest point of a triangle mesh, and of the material as a whole, to given points."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from mphygs.scene.rays import checked_points, expand, inside

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# Points looked at together; each may have every triangle as a candidate.
_POINTS_AT_ONCE = 256
_FIRST_GUESSES = 8


class MaterialAnchor(NamedTuple):
    """The nearest material point of each of M points.

    part: (M,) int; anchor: (M, 3), the point itself where it lies inside [m];
    offset: (M, 3), point - anchor [m].
    """

    part: np.ndarray
    anchor: np.ndarray
    offset: np.ndarray


def closest_material(parts: Sequence[Part], points: np.ndarray) -> MaterialAnchor:
    """The nearest point of the union of the parts' meshes to each point, for markers that sit on or off it.

    points: (M, 3) [m]. Inside several parts, or equally near to them, the first of them counts.
    Raises ValueError if there are no parts or if points is not a finite (M, 3) array.
    """
    points = checked_points(points, "points")
    if len(parts) == 0:
        raise ValueError("parts: got none, expected at least one closed mesh")
    owner = np.zeros(len(points), dtype=np.int64)
    anchor = points.copy()
    distance = np.full(len(points), np.inf)
    for number, part in enumerate(parts):
        within = inside(part, points) & (distance > 0.0)
        owner[within], anchor[within], distance[within] = number, points[within], 0.0
        rest = np.flatnonzero(distance > 0.0)
        on_mesh, gap = closest_on_mesh(part.vertices, part.faces, points[rest])
        nearer = gap < distance[rest]
        chosen = rest[nearer]
        owner[chosen], anchor[chosen], distance[chosen] = number, on_mesh[nearer], gap[nearer]
    return MaterialAnchor(owner, anchor, points - anchor)


def closest_on_mesh(
    vertices: np.ndarray, faces: np.ndarray, points: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Exact closest point of a triangle mesh to each point.

    vertices: (V, 3) [m]; faces: (F, 3) int; points: (M, 3) [m] -> closest (M, 3) [m], distance (M,) [m].
    """
    corners = vertices[faces]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    tree = cKDTree(centre)
    guesses = min(_FIRST_GUESSES, len(faces))
    closest, distance = np.empty((len(points), 3)), np.empty(len(points))
    for begin in range(0, len(points), _POINTS_AT_ONCE):
        some = points[begin : begin + _POINTS_AT_ONCE]
        guess = tree.query(some, k=[*range(1, guesses + 1)])[1]
        _, gap = _closest_on_triangles(corners[guess.ravel()], np.repeat(some, guesses, axis=0))
        bound = gap.reshape(len(some), guesses).min(axis=1)
        # No triangle whose centre is further than this can be nearer; the slack covers rounding.
        slack = 1e-12 * (1.0 + np.abs(vertices).max())
        near = tree.query_ball_point(some, bound + radius.max() + slack)
        row, _ = expand(np.array([len(each) for each in near]))
        triangle = np.concatenate([np.asarray(each, dtype=np.int64) for each in near])
        reach = np.linalg.norm(centre[triangle] - some[row], axis=1) - radius[triangle]
        close = reach <= bound[row] + slack
        row, triangle = row[close], triangle[close]
        found, gap = _closest_on_triangles(corners[triangle], some[row])
        order = np.lexsort((triangle, gap, row))
        first = order[np.concatenate([[True], np.diff(row[order]) > 0])]
        closest[begin : begin + len(some)], distance[begin : begin + len(some)] = found[first], gap[first]
    return closest, distance


def _closest_on_triangles(corners: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Closest point of the n-th triangle to the n-th point; corners (N, 3, 3), points (N, 3)."""
    best = corners[:, 0].copy()
    gap = np.linalg.norm(points - best, axis=1)

    def offer(candidate: np.ndarray, valid: np.ndarray) -> None:
        length = np.linalg.norm(points - candidate, axis=1)
        better = valid & (length < gap)
        best[better], gap[better] = candidate[better], length[better]

    for k in range(3):
        start, along = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        square = np.einsum("ni,ni->n", along, along)
        share = np.einsum("ni,ni->n", points - start, along) / np.where(square > 0.0, square, 1.0)
        offer(start + np.clip(share, 0.0, 1.0)[:, None] * along, square > 0.0)
    # The foot of the perpendicular, where it falls inside the triangle.
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(first, second)
    square = np.einsum("ni,ni->n", normal, normal)
    safe = np.where(square > 0.0, square, 1.0)
    arm = points - corners[:, 0]
    v = np.einsum("ni,ni->n", np.cross(arm, second), normal) / safe
    w = np.einsum("ni,ni->n", np.cross(first, arm), normal) / safe
    within = (square > 0.0) & (v >= 0.0) & (w >= 0.0) & (v + w <= 1.0)
    offer(corners[:, 0] + v[:, None] * first + w[:, None] * second, within)
    return best, gap
