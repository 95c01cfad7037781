"""Where a closed surface is: inside tests by winding number, exact triangle-box overlap, distances."""

from __future__ import annotations

import numpy as np

_CHUNK = 2_000_000  # point-triangle pairs held in memory at once
# Triangles above which those far away are taken together, so many of them a group on average.
_MANY, _TOGETHER = 5_000, 64
# A group is far where it lies so many times its own radius away: its share is then right to a percent.
_FAR = 3.0


def winding_number(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How often a closed surface goes round each point: 1 inside, 0 outside. Returns (N,).

    points: (N, 3) [m]; vertices: (V, 3) [m]; faces: (F, 3), outward. The sum of the solid angles of the
    triangles over 4 pi (van Oosterom and Strackee 1983); of many triangles those far from a point by groups,
    as dipoles (Barill et al., "Fast winding numbers for soups and clouds", 2018), to some hundredths.
    """
    points = np.asarray(points, dtype=np.float64).reshape(-1, 3)
    if len(faces) > _MANY:
        return _winding_of_many(points, vertices[faces])
    winding = np.empty(len(points))
    step = max(1, _CHUNK // max(1, len(faces)))
    for start in range(0, len(points), step):
        corner = vertices[faces][None] - points[start : start + step, None, None]
        winding[start : start + step] = _solid_angles(corner).sum(axis=1) / (4 * np.pi)
    return winding


def _solid_angles(corner: np.ndarray) -> np.ndarray:
    """Of triangles (..., 3, 3) [m], seen from the origin [sr]."""
    a, b, c = np.moveaxis(corner, -2, 0)
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    volume = np.einsum("...i,...i->...", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("...i,...i->...", p, q) for p, q in ((a, b), (b, c), (c, a)))
    return 2 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)


def _winding_of_many(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """As `winding_number`, of triangles (F, 3, 3) [m] sorted into cubes."""
    middle = triangles.mean(axis=1)
    low = middle.min(axis=0)
    # A surface fills about the square of as many cubes as there are along an edge.
    count = max(1, round((len(triangles) / _TOGETHER) ** 0.5))
    edge = max(float(np.ptp(middle, axis=0).max()) / count, 1e-300)
    cube = np.minimum(((middle - low) / edge).astype(np.int64), count - 1) @ np.array([count**2, count, 1])
    order = np.argsort(cube, kind="stable")
    triangles, middle = triangles[order], middle[order]
    begin = np.flatnonzero(np.diff(cube[order], prepend=-1))
    size = np.diff(np.append(begin, len(order)))
    area = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    weight = np.linalg.norm(area, axis=1) + 1e-300
    centre = np.add.reduceat(weight[:, None] * middle, begin) / np.add.reduceat(weight, begin)[:, None]
    dipole = np.add.reduceat(area, begin)
    group = np.repeat(np.arange(len(begin)), size)
    reach = ((triangles - centre[group, None]) ** 2).sum(axis=2).max(axis=1)
    radius = np.sqrt(np.maximum.reduceat(reach, begin))
    winding = np.empty(len(points))
    for number, point in enumerate(points):
        away = centre - point
        distance = np.linalg.norm(away, axis=1)
        far = distance > _FAR * radius
        shares = np.einsum("gi,gi->g", away[far], dipole[far]) / distance[far] ** 3
        winding[number] = shares.sum() + _solid_angles(triangles[~far[group]] - point).sum()
    return winding / (4 * np.pi)


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
