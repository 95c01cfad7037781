"""The middle surface of a thin closed mesh: samples with normal and thickness, and two coordinates on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from mphygs.capture.triangles import directed_edges
from mphygs.scene.finer_meshes import finer

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# About how many samples, and triangles and rays that are looked at together.
_SAMPLES, _AT_ONCE = 900, 1 << 22
# A sample whose opposite side is this many times further off than the usual one lies on the rim.
_RIM = 2.0
# Cosine of the steepest slope of a sheet that lies over a plane, and neighbours that ways along it go to.
_STEEPEST, _NEIGHBOURS = 0.5, 10


class MiddleSurface(NamedTuple):
    """place: (n, 3) [m]; normal: (n, 3) unit, to one side all over; thickness: (n,) [m]; flat: (n, 2)
    coordinates along the sheet that keep distances as well as a plane can [m]."""

    place: np.ndarray
    normal: np.ndarray
    thickness: np.ndarray
    flat: np.ndarray


class Chords(NamedTuple):
    """Straight ways through a mesh against its normals. start: (n, 3) on the surface [m]; normal: (n, 3),
    outward there; length: (n,) to the opposite side [m]; area: (n,) what each stands for [m^2]."""

    start: np.ndarray
    normal: np.ndarray
    length: np.ndarray
    area: np.ndarray

    @property
    def usual(self) -> float:
        """The median over the area [m]: of a sheet its thickness, of a rod its narrow width."""
        order = np.argsort(self.length)
        share = np.cumsum(self.area[order])
        return float(self.length[order][np.searchsorted(share, 0.5 * share[-1])])


def chords(part: Part) -> Chords:
    """Chords from about 900 places spread evenly over the surface."""
    vertices, faces = finer(part.vertices, part.faces, np.sqrt(part.area / _SAMPLES) * 1.5)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double = np.linalg.norm(cross, axis=1)
    good = double > 1e-12 * double.max()
    # Evenly over the area, the same every time.
    total = np.cumsum(double[good])
    share = total[-1] / _SAMPLES
    chosen = np.unique(np.searchsorted(total, share * (np.arange(_SAMPLES) + 0.5)))
    faces_of = np.flatnonzero(good)[chosen]
    start, normal = corners[faces_of].mean(axis=1), cross[faces_of] / double[faces_of, None]
    length = _through(part.vertices[part.faces], start, -normal)
    hit = np.isfinite(length)
    area = np.diff(np.r_[0.0, total[chosen]]) / 2.0
    return Chords(start[hit], normal[hit], length[hit], area[hit])


def _through(corners: np.ndarray, start: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(n,) ways to the nearest triangle that is seen from its back, infinite where there is none."""
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
    middle = corners.reshape(-1, 3).mean(axis=0)  # no digits are lost on where the part is
    corners, start = corners - middle, start - middle
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(edge, other)
    height = (corners[:, 0] * normal).sum(-1)
    by_edge, by_other = np.cross(edge, corners[:, 0]), np.cross(other, corners[:, 0])
    result = np.full(len(start), np.inf)
    chunk = max(1, _AT_ONCE // len(corners))
    for begin in range(0, len(start), chunk):
        s, d = start[begin : begin + chunk], direction[begin : begin + chunk]
        # Of the arm from a triangle's corner to the start: arm . normal, and (arm x d) . edge.
        facing, turn = d @ normal.T, np.cross(s, d)
        with np.errstate(divide="ignore", invalid="ignore"):
            way = (height - s @ normal.T) / facing
            u = (turn @ other.T - d @ by_other.T) / -facing
            v = (turn @ edge.T - d @ by_edge.T) / facing
            hit = (facing > 0) & (way > 1e-9 * size) & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1.0 + 1e-9)
        result[begin : begin + chunk] = np.where(hit, way, np.inf).min(axis=1)
    return result


def middle_surface(part: Part) -> MiddleSurface:
    """Of a sheet. Raises ValueError where it is of several pieces, has no two sides, or closes to a tube."""
    piece = trimesh.graph.connected_component_labels(directed_edges(part.faces))[part.faces[:, 0]]
    if np.ptp(piece) > 0:
        raise ValueError(f"part '{part.name}': a sheet of several pieces, expected one, or \"as\": \"solid\"")
    found = chords(part)
    kept = found.length < _RIM * found.usual
    place = found.start[kept] - 0.5 * found.length[kept, None] * found.normal[kept]
    thickness, normal = found.length[kept], found.normal[kept]
    middle = place.mean(axis=0)
    axes = np.linalg.svd(place - middle, full_matrices=False)[2]
    up = normal @ axes[2]
    if np.mean(np.abs(up) > _STEEPEST) > 0.95:
        flat = (place - middle) @ axes[:2].T
        normal = normal * np.sign(up)[:, None]
    else:
        flat, normal = _unrolled(place, normal, part.name)
    return MiddleSurface(place, normal, thickness, _turned(flat))


def _turned(flat: np.ndarray) -> np.ndarray:
    """Coordinates along the sides of the smallest rectangle around, the longer first."""
    (_, _), size, angle = cv2.minAreaRect(flat.astype(np.float32))
    c, s = np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))
    turned = flat @ np.array([[c, -s], [s, c]])
    return turned if size[0] >= size[1] else np.stack([turned[:, 1], -turned[:, 0]], axis=1)


def _unrolled(place: np.ndarray, normal: np.ndarray, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates from shortest ways along the sheet (Isomap: Tenenbaum, de Silva, Langford 2000), and the
    normals all to one side."""
    away, near = cKDTree(place).query(place, k=_NEIGHBOURS + 1)
    row = np.repeat(np.arange(len(place)), _NEIGHBOURS)
    shape = (len(place), len(place))
    length = np.maximum(away[:, 1:].ravel(), 1e-12)
    graph = coo_matrix((length, (row, near[:, 1:].ravel())), shape=shape).tocsr()
    if connected_components(graph, directed=False)[0] > 1:
        raise ValueError(f"part '{name}': a sheet of several pieces, expected one, or \"as\": \"solid\"")
    way = dijkstra(graph, directed=False)
    centred = way**2 - (way**2).mean(0) - (way**2).mean(1)[:, None] + (way**2).mean()
    value, vector = np.linalg.eigh(-0.5 * centred)
    if value[-3] > 0.25 * value[-2]:
        raise ValueError(
            f"part '{name}': a sheet that closes on itself or bends two ways does not unroll onto a plane, "
            'expected one that does, or "as": "solid"'
        )
    flat = vector[:, -2:] * np.sqrt(value[-2:])
    # Sides spread from neighbour to neighbour, along the graph from the middle.
    begin = int(np.argmin(way.max(axis=1)))
    before = dijkstra(graph, directed=False, indices=begin, return_predecessors=True)[1]
    normal = normal.copy()
    for k in np.argsort(way[begin], kind="stable")[1:]:
        normal[k] *= np.sign(normal[k] @ normal[before[k]]) or 1.0
    return flat, normal
