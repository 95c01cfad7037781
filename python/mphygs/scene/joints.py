"""Where two parts touch: samples of every joint between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from mphygs.capture.meshes import enclosed_volume
from mphygs.scene.closest import closest_on_mesh
from mphygs.scene.rays import checked_boxes, inside

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# In spacings: parts this near touch; a sample's longest edge; the shortest edge at a joint's rim, which is a
# quarter of the thinner part's thickness between these two; neighbouring voxels of this side are one joint.
TOUCHING = 1e-3
LONGEST = 1.0 / 3.0
SHORTEST = (1.0 / 24.0, 1.0 / 8.0)
TOGETHER = 0.25
# Gaps, in spacings, over which a part that nothing else holds is taken to be joined.
GAPS = (0.05, 0.25, 1.0)


@dataclass(frozen=True, eq=False)
class Joint:
    """One connected piece of the interface of two parts.

    parts: their indices, the first owns the material where they overlap; points: (Q, 3) [m];
    area: (Q,) what each stands for [m^2]; normal: (Q, 3), unit, out of the first part.
    """

    parts: tuple[int, int]
    points: np.ndarray
    area: np.ndarray
    normal: np.ndarray


def find_joints(
    parts: Sequence[Part],
    *,
    spacing: float,
    exclude_boxes: np.ndarray | None = None,
    grounded: Sequence[int] = (),
) -> list[Joint]:
    """All joints between parts, in the order of their parts.

    spacing: of the grid, which sets how finely samples lie [m]; exclude_boxes: (H, 2, 3) [m], held material;
    grounded: parts that something else holds. A group of parts with none of them that touches no grounded one
    is joined over the smallest of `GAPS` that reaches: scanned surfaces seldom close exactly.
    Raises ValueError on a spacing that is not positive and on malformed boxes.
    """
    boxes = checked_boxes(exclude_boxes, "exclude_boxes")
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise ValueError(f"spacing: got {spacing}, expected a positive length in metres")
    pairs = [(a, b) for a in range(len(parts)) for b in range(a + 1, len(parts))]
    pieces = [_pieces(part) for part in parts]

    def between(a: int, b: int, reach: float) -> list[Joint]:
        both = [(one, other) for one in pieces[a] for other in pieces[b]]
        return [j for pair in both for j in _between(parts, (a, b), pair, boxes, spacing, reach)]

    found = {pair: between(*pair, TOUCHING * spacing) for pair in pairs}
    for gap in GAPS:
        loose = _loose(len(parts), found, grounded)
        for a, b in pairs:
            if not found[a, b] and loose[a] != loose[b] and 0 in (loose[a], loose[b]):
                found[a, b] = between(a, b, gap * spacing)
    return [joint for pair in pairs for joint in found[pair]]


def _loose(count: int, found: dict[tuple[int, int], list[Joint]], grounded: Sequence[int]) -> np.ndarray:
    """(count,) 0 for parts that hang together with a grounded one (the first part, where there is none)."""
    ground = list(grounded) or [0]
    edges = [pair for pair, joints in found.items() if joints] + [(ground[0], other) for other in ground[1:]]
    rows, columns = np.array(edges, int).reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    label = connected_components(graph, directed=False)[1]
    return np.where(label == label[ground[0]], 0, label + 1)


class _Piece(NamedTuple):
    """A connected piece of a part's mesh: the petals of a ring may be one part."""

    name: str
    vertices: np.ndarray
    faces: np.ndarray


def _pieces(part: Part) -> list[_Piece]:
    faces, count = part.faces, len(part.vertices)
    edges = np.concatenate([faces[:, :2], faces[:, 1:]])
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(count, count))
    label = connected_components(graph, directed=False)[1][faces[:, 0]]
    found = [_Piece(part.name, part.vertices, faces[label == k]) for k in np.unique(label)]
    # A hole inside is no piece of its own.
    hollow = any(not enclosed_volume(piece.vertices, piece.faces) > 0.0 for piece in found)
    return [_used(piece) for piece in ([part] if hollow else found)]


def _used(piece: _Piece | Part) -> _Piece:
    """The piece without vertices that it does not use, which would count in its bounds."""
    kept, index = np.unique(piece.faces, return_inverse=True)
    return _Piece(piece.name, piece.vertices[kept], index.reshape(piece.faces.shape))


def _between(
    parts: Sequence[Part], pair: tuple[int, int], pieces: tuple[_Piece, _Piece], boxes: np.ndarray,
    spacing: float, reach: float,
) -> list[Joint]:  # fmt: skip
    (first, second), (one, other) = pair, pieces
    low, high = other.vertices.min(0) - reach, other.vertices.max(0) + reach
    corners = one.vertices[one.faces]
    near = ((corners.max(1) >= low) & (corners.min(1) <= high)).all(1)
    if not near.any():
        return []
    thickness = min(_thickness(one), _thickness(other))
    shortest = float(np.clip(thickness / 4.0, SHORTEST[0] * spacing, SHORTEST[1] * spacing))
    points, area, normal = _covered(corners[near], other, LONGEST * spacing, shortest, reach)
    step = min(reach, TOUCHING * spacing)
    kept = np.ones(len(points), bool)
    for box in boxes:
        for side in (points - step * normal, points + step * normal):
            kept &= ~((side > box[0]) & (side < box[1])).all(1)
    # Where parts overlap the earlier one owns the material, on both sides of the surface.
    for third in range(second):
        asked = np.flatnonzero(kept)
        if third != first and len(asked):
            kept[asked] = ~inside(parts[third], points[asked] + step * normal[asked])
        asked = np.flatnonzero(kept)
        if third < first and len(asked):
            kept[asked] = ~inside(parts[third], points[asked] - step * normal[asked])
    points, area, normal = points[kept], area[kept], normal[kept]
    if not len(points):
        return []
    place, voxel = np.unique(np.floor(points / (TOGETHER * spacing)), axis=0, return_inverse=True)
    close = cKDTree(place).query_pairs(1.0, p=np.inf, output_type="ndarray")
    graph = coo_matrix((np.ones(len(close)), close.T), shape=(len(place), len(place)))
    count, label = connected_components(graph, directed=False)
    label = label[voxel.ravel()]
    return [
        Joint((first, second), points[label == k], area[label == k], normal[label == k])
        for k in range(count)
    ]


def _thickness(part: _Piece) -> float:
    """Twice the volume over the surface: the thickness of a sheet [m]."""
    corners = part.vertices[part.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 4.0 * enclosed_volume(part.vertices, part.faces) / float(np.linalg.norm(cross, axis=1).sum())


def _covered(
    triangles: np.ndarray, other: _Piece, longest: float, shortest: float, reach: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centroids, areas and normals of the pieces of triangles (T, 3, 3) outside of which `other` begins.

    Triangles are halved along their longest edge: to `longest` where the other part's surface is far, to
    `shortest` where it is near [m].
    """
    points, area, normal = [np.empty((0, 3))], [np.empty(0)], [np.empty((0, 3))]
    corners = other.vertices[other.faces]
    tree = cKDTree(corners.mean(axis=1))
    widest = float(np.linalg.norm(corners - corners.mean(axis=1, keepdims=True), axis=2).max())
    while len(triangles):
        edges = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
        length = edges.max(1)
        cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        double = np.linalg.norm(cross, axis=1)
        real = double > 1e-12 * length * shortest
        triangles, edges, length, cross, double = (
            x[real] for x in (triangles, edges, length, cross, double)
        )
        outward, centre = cross / double[:, None], triangles.mean(1)
        # No nearer than this: how near is asked only where it matters.
        gap = tree.query(centre)[0] - widest
        asked = gap <= length + reach
        gap[asked] = closest_on_mesh(other.vertices, other.faces, centre[asked])[1]
        reached = inside(other, centre + reach * outward) | (gap <= reach)
        near = gap <= length + reach
        split = (near & (length > shortest)) | (reached & (length > longest))
        done = ~split & reached
        points.append(centre[done])
        area.append(0.5 * double[done])
        normal.append(outward[done])
        # From the middle of the longest edge to the corner opposite.
        turn = (edges[split].argmax(1)[:, None] + np.arange(3)) % 3
        start, end, far = np.moveaxis(np.take_along_axis(triangles[split], turn[:, :, None], axis=1), 1, 0)
        middle = 0.5 * (start + end)
        triangles = np.concatenate(
            [np.stack([start, middle, far], axis=1), np.stack([middle, end, far], axis=1)]
        )
    return np.concatenate(points), np.concatenate(area), np.concatenate(normal)
