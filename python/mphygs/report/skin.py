"""The object's surface as a mesh to be painted: fine enough to bend, coarse enough for a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import trimesh
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# Markers that a place of the surface takes its error from.
NEIGHBOURS = 6
# A mesh is divided as long as it has fewer than this share of the vertices wanted.
SPARSE = 0.35


@dataclass(frozen=True, eq=False)
class Skin:
    """points: (V, 3) at rest [m]; faces: (F, 3); part: (V,) index."""

    points: np.ndarray
    faces: np.ndarray
    part: np.ndarray


def skin_of(parts: Sequence[Part], count: int) -> Skin:
    """The surfaces of all parts with about count vertices in all."""
    area = np.array([part.area for part in parts])
    points, faces, number, first = [], [], [], 0
    for index, part in enumerate(parts):
        wanted = max(int(count * area[index] / area.sum()), 24)
        own, triangles = _resized(part.vertices, part.faces, wanted)
        points.append(own)
        faces.append(triangles + first)
        number.append(np.full(len(own), index))
        first += len(own)
    return Skin(np.concatenate(points), np.concatenate(faces), np.concatenate(number))


def _resized(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A mesh of about count vertices: triangles cut in four as it takes, or vertices put together."""
    while len(vertices) < SPARSE * count:
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    if len(vertices) <= 1.1 * count:
        return np.asarray(vertices), np.asarray(faces)
    low, reach = vertices.min(0), float(np.ptp(vertices, axis=0).max())
    side = _side(vertices, faces)

    def cells_of(edge: float) -> np.ndarray:
        """(V, 4): the two faces of a sheet that is thinner than a cell are not put together."""
        return np.column_stack([np.floor((vertices - low) / edge).astype(np.int64), side])

    fine, coarse = 0.0, reach * 1.001
    for _ in range(30):
        edge = 0.5 * (fine + coarse)
        cells = len(np.unique(cells_of(edge), axis=0))
        fine, coarse = (edge, coarse) if cells > count else (fine, edge)
    return _clustered(vertices, faces, cells_of(coarse))


def _side(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V,) which of the six directions along the axes the normal of each vertex is nearest to."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    own = np.cross(b - a, c - a)
    normal = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normal, faces[:, corner], own)
    axis = np.abs(normal).argmax(1)
    return 2 * axis + (np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] > 0.0)


def _clustered(vertices: np.ndarray, faces: np.ndarray, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices of a cell as their mean; triangles within one cell, and twins, are gone."""
    _, label = np.unique(cell, axis=0, return_inverse=True)
    label = label.ravel()
    members = np.bincount(label)
    mean = np.stack([np.bincount(label, vertices[:, a]) / members for a in range(3)], axis=1)
    moved = label[faces]
    real = (moved != np.roll(moved, 1, axis=1)).all(1)
    moved = moved[real]
    _, kept = np.unique(np.sort(moved, axis=1), axis=0, return_index=True)
    used, compact = np.unique(moved[np.sort(kept)], return_inverse=True)
    return mean[used], compact.reshape(-1, 3)


def nearest_markers(skin: Skin, at: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(V, K) markers that each vertex takes its error from, and the weight of each, by the inverse square of
    the distance; K is 0 without markers.

    at: (M, 3) markers at rest [m]; owner: (M,) the part of each. A vertex is told by markers of its own part,
    by those of any part where that has too few.
    """
    count = min(NEIGHBOURS, len(at))
    near, weight = np.zeros((len(skin.points), count), int), np.zeros((len(skin.points), count))
    if not count:
        return near, weight
    for index in np.unique(skin.part):
        mine = skin.part == index
        own = np.flatnonzero(owner == index)
        own = own if len(own) >= count else np.arange(len(at))
        distance, found = cKDTree(at[own]).query(skin.points[mine], k=count)
        inverse = 1.0 / (distance.reshape(-1, count) ** 2 + 1e-16)
        near[mine] = own[found.reshape(-1, count)]
        weight[mine] = inverse / inverse.sum(1, keepdims=True)
    return near, weight
