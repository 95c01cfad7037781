"""Where a closed surface is: inside tests by winding number, exact triangle-box overlap, distances."""

from __future__ import annotations

import numpy as np

_CHUNK = 2_000_000  # point-triangle pairs held in memory at once


def winding_number(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How often a closed surface goes round each point: 1 inside, 0 outside. Returns (N,).

    points: (N, 3) [m]; vertices: (V, 3) [m]; faces: (F, 3), outward. The sum of the solid angles of the
    triangles over 4 pi (van Oosterom and Strackee 1983).
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    winding = np.empty(len(points))
    step = max(1, _CHUNK // max(1, len(faces)))
    for start in range(0, len(points), step):
        corner = vertices[faces][None] - points[start : start + step, None, None]
        a, b, c = corner[:, :, 0], corner[:, :, 1], corner[:, :, 2]
        la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
        volume = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("nfi,nfi->nf", p, q) for p, q in ((a, b), (b, c), (c, a)))
        angle = 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
        winding[start : start + step] = angle.sum(axis=1) / (4 * np.pi)
    return winding


def just_inside(vertices: np.ndarray, faces: np.ndarray, count: int = 40) -> np.ndarray:
    """Points (N, 3) [m] under the middles of some of the faces, 1e-4 of the surface's size deep."""
    a, b, c = np.moveaxis(vertices[faces[:: max(1, len(faces) // count)]], 1, 0)
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    depth = 1e-4 * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    seen = length[:, 0] > 0
    return ((a + b + c) / 3.0 - depth * normal / np.where(length > 0, length, 1.0))[seen]


def triangles_in_box(triangles: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Which triangles share a point with an axis-aligned box. Returns (F,) bool.

    triangles: (F, 3, 3) [m]; box: (2, 3) [m], lower and upper corner. Separating axes: three of the box, nine
    edge products, the normal (Akenine-Moller 2001).
    """
    half = (box[1] - box[0]) / 2
    corners = triangles - (box[0] + box[1]) / 2
    edges = np.roll(corners, -1, axis=1) - corners  # (F, 3, 3)
    products = np.cross(np.eye(3)[None, :, None], edges[:, None])  # (F, box axis, edge, 3)
    normal = np.cross(edges[:, 0], edges[:, 1])
    units = np.broadcast_to(np.eye(3), (len(triangles), 3, 3))
    axes = np.concatenate([units, products.reshape(-1, 9, 3), normal[:, None]], axis=1)  # (F, 13, 3)
    along = np.einsum("fai,fci->fac", axes, corners)
    reach = np.abs(axes) @ half
    apart = (along.min(axis=2) > reach) | (along.max(axis=2) < -reach)
    return ~apart.any(axis=1)


def box_meets_solid(box: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether a box (2, 3) [m] shares a point with the solid inside a closed surface."""
    if (vertices.max(axis=0) < box[0]).any() or (vertices.min(axis=0) > box[1]).any():
        return False
    if triangles_in_box(vertices[faces], box).any():
        return True
    # no surface in the box: it lies wholly inside or wholly outside
    return bool(winding_number(box.mean(axis=0), vertices, faces)[0] > 0.5)


def distance_to_box(points: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Distances (N,) [m] of points (N, 3) [m] to a box (2, 3) [m]; zero inside."""
    return np.linalg.norm(np.maximum(np.maximum(box[0] - points, points - box[1]), 0.0), axis=-1)
