"""Closed meshes of an object's segments: each bounded by the object's surface and by its neighbours."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from mphygs.capture.meshes import Part
from mphygs.scene.lattice import Lattice

_MARGIN = 3  # voxels round a segment
_LEAST_BODY = 0.03  # of a part's largest body; smaller ones are specks
_NUDGE = 1e-6  # of a voxel, by which values of exactly zero are moved


def segment_meshes(
    lattice: Lattice, distance: np.ndarray, points: np.ndarray, label: np.ndarray, names: list[str]
) -> list[Part]:
    """One part a segment, where distance <= 0 and the nearest labelled point is of the segment.

    distance: (X, Y, Z) on `lattice` [m], negative inside; points: (N, 3) [m] with label: (N,) int; names: of
    the segments. Marching cubes (Lewiner et al. 2003) of max(distance, half the difference of the distances
    to the nearest points of the segment and of others), so that neighbours meet half way between points.
    Raises ValueError for a segment that encloses no volume.
    """
    padded = np.pad(distance, 1, constant_values=float(lattice.spacing))
    corner = lattice.corner - lattice.spacing
    everywhere = np.arange(len(names))
    trees = {s: cKDTree(points[label == s]) for s in everywhere}
    parts = []
    for segment, name in enumerate(names):
        own = points[label == segment]
        low = np.floor((own.min(axis=0) - corner) / lattice.spacing).astype(int) - _MARGIN
        high = np.ceil((own.max(axis=0) - corner) / lattice.spacing).astype(int) + _MARGIN + 1
        low, high = np.maximum(low, 0), np.minimum(high, padded.shape)
        field = padded[tuple(slice(a, b) for a, b in zip(low, high, strict=True))].copy()
        near = np.argwhere(field < 2.0 * lattice.spacing)
        places = corner + lattice.spacing * (low + near)
        to_own = trees[segment].query(places)[0]
        to_other = np.full(len(places), np.inf)
        for other in everywhere[everywhere != segment]:
            found = trees[other].query(places, distance_upper_bound=float(to_own.max()) + lattice.spacing)[0]
            to_other = np.minimum(to_other, found)
        border = 0.5 * (to_own - to_other)
        index = tuple(near.T)
        field[index] = np.maximum(field[index], np.where(np.isfinite(border), border, -lattice.spacing))
        part = _part(name, field, corner + lattice.spacing * low, lattice.spacing)
        if part is None:
            raise ValueError(
                f"segment {name}: encloses no volume; expected a finer lattice or fewer segments"
            )
        parts.append(part)
    return parts


def _part(name: str, field: np.ndarray, corner: np.ndarray, spacing: float) -> Part | None:
    # in voxels, closed at the edge of the box, no value exactly on the surface
    values = np.pad(field / spacing, 1, constant_values=1.0)
    values = np.where(np.abs(values) < _NUDGE, _NUDGE, values)
    if not (values < 0).any():
        return None
    vertices, faces, _, _ = marching_cubes(values, level=0.0, gradient_direction="ascent")
    faces = faces.astype(np.int64)
    vertices, faces = _without_specks(vertices.astype(np.float64), faces)
    if len(faces) == 0:
        return None
    return Part(name, corner + spacing * (vertices - 1.0), faces)


def _without_specks(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The bodies of a closed mesh that enclose enough, cavities filled, faces outward."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    graph = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(vertices), len(vertices)))
    body = connected_components(graph, directed=False)[1][faces[:, 0]]
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    volume = np.bincount(body, weights=np.einsum("fi,fi->f", a, np.cross(b, c)) / 6.0)
    if abs(volume.min()) > volume.max():
        volume, faces = -volume, faces[:, ::-1]
    kept = volume >= _LEAST_BODY * volume.max()
    faces = faces[kept[body]]
    used, index = np.unique(faces, return_inverse=True)
    return vertices[used], index.reshape(-1, 3)
