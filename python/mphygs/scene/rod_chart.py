"""The chart of a rod: its centre line, found from the mesh, with two directions across."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.interpolate import make_lsq_spline
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from mphygs.scene.curved_charts import Chart
from mphygs.scene.finer_meshes import finer

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# Of a rod's own width: longest edge of the mesh that its line is found on, and how far apart knots stand.
_EDGE, _KNOTS = 0.5, 3.0
# How often the line and the points' places along it are found from each other.
_ROUNDS = 4
# Of a rod's own width, how far from its line none of it is.
_ASIDE = 5.0
# A rod is at least so many times as long as it is wide.
SLENDER = 3.0


class CentreLine(NamedTuple):
    """A smooth line through a rod with directions across it.

    along: (n,) arc length [m]; place: (n, 3) [m]; first, second: (n, 3) unit, square to the line, to each
    other and turned with it no more than they must; width: (n, 2) that the rod has along them [m];
    low, high: where the rod begins and ends along the line [m].
    """

    along: np.ndarray
    place: np.ndarray
    first: np.ndarray
    second: np.ndarray
    width: np.ndarray
    low: float
    high: float

    def at(self, along: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places (m, 3) at arc lengths (m,) and the two directions there times the widths (m, 3) [m].

        Beyond its ends the line goes on straight.
        """
        inner = np.clip(along, self.along[0], self.along[-1])
        place, first, second, width = (
            np.stack([np.interp(inner, self.along, values[:, c]) for c in range(values.shape[1])], axis=1)
            for values in (self.place, self.first, self.second, self.width)
        )
        ends = [self.place[1] - self.place[0], self.place[-1] - self.place[-2]]
        for beyond, end in ((np.minimum(along - self.along[0], 0.0), ends[0]),
                            (np.maximum(along - self.along[-1], 0.0), ends[1])):  # fmt: skip
            place = place + beyond[:, None] * end / np.linalg.norm(end)
        return place, width[:, :1] * first, width[:, 1:] * second

    def along_of(self, points: np.ndarray) -> np.ndarray:
        """(m,) arc lengths of the places on the line nearest to points (m, 3) [m]."""
        return _along(self.place, points)


def centre_line(part: Part) -> CentreLine:
    """The line along which a part is longest, from its mesh alone.

    Arc lengths are first those of shortest ways over the surface from one end; then line and arc lengths are
    found from each other. Raises ValueError where the part is too short for a rod, or closes to a ring.
    """
    rough = np.sqrt(part.volume / np.linalg.norm(np.ptp(part.vertices, axis=0)))
    vertices, faces = finer(part.vertices, part.faces, _EDGE * rough)
    edges = np.unique(np.sort(np.concatenate([faces[:, :2], faces[:, 1:], faces[:, ::2]]), axis=1), axis=0)
    length = np.linalg.norm(np.diff(vertices[edges], axis=1)[:, 0], axis=1)
    graph = coo_matrix((length, edges.T), shape=(len(vertices), len(vertices))).tocsr()
    if connected_components(graph, directed=False)[0] > 1:
        raise ValueError(f"part '{part.name}': a rod of several pieces, expected one, or \"as\": \"solid\"")
    end = int(np.argmax(dijkstra(graph, directed=False, indices=0)))
    along = dijkstra(graph, directed=False, indices=end)
    weight = _vertex_areas(vertices, faces)
    width = np.sqrt(part.volume / along.max())
    _check_slender(along, width, part.name)
    for _ in range(_ROUNDS):
        line = _fitted(along, vertices, weight, width)
        along = _along(line, vertices)
    _check_slender(along, width, part.name)  # over the surface it is longer
    return _with_sections(line, vertices, weight, along, width, part.name)


def _check_slender(along: np.ndarray, width: float, name: str) -> None:
    length = np.ptp(along)
    if length < SLENDER * width:
        raise ValueError(
            f"part '{name}': {length:.3g} m long and {width:.3g} m wide, expected a rod at least "
            f'{SLENDER:g} times as long as wide, or "as": "solid"'
        )


def _vertex_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return np.bincount(faces.ravel(), np.repeat(area / 6.0, 3), minlength=len(vertices))


def _fitted(along: np.ndarray, points: np.ndarray, weight: np.ndarray, width: float) -> np.ndarray:
    """(n, 3) places on a smooth line, least squares to the points at their arc lengths, even and dense."""
    low, high = along.min(), along.max()
    # End caps pull the line aside: what lies within half a width of an end does not count.
    inner = (along > low + 0.5 * width) & (along < high - 0.5 * width) & (weight > 0.0)
    order = np.argsort(along[inner], kind="stable")
    x, y, w = along[inner][order], points[inner][order], np.sqrt(weight[inner][order])
    pieces = max(1, int((high - low) / (_KNOTS * width)))
    degree = 3 if pieces > 1 else 1
    knots = np.linspace(x[0], x[-1], pieces + 1)
    spline = make_lsq_spline(x, y, np.r_[[knots[0]] * degree, knots, [knots[-1]] * degree], k=degree, w=w)
    dense = spline(np.linspace(x[0], x[-1], 20 * pieces + 1))
    step = np.linalg.norm(np.diff(dense, axis=0), axis=1)
    even = np.linspace(0.0, step.sum(), len(dense))
    arc = np.r_[0.0, np.cumsum(step)]
    return np.stack([np.interp(even, arc, dense[:, c]) for c in range(3)], axis=1)


def _along(line: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Arc length of the nearest place on a line (n, 3), which goes on straight beyond its ends."""
    step = np.diff(line, axis=0)
    length = np.linalg.norm(step, axis=1)
    arc = np.r_[0.0, np.cumsum(length)]
    near = cKDTree(line).query(points)[1]
    best, gap = np.zeros(len(points)), np.full(len(points), np.inf)
    for piece in (np.clip(near - 1, 0, len(step) - 1), np.clip(near, 0, len(step) - 1)):
        share = np.einsum("pc,pc->p", points - line[piece], step[piece]) / length[piece] ** 2
        low = np.where(piece == 0, -np.inf, 0.0)
        high = np.where(piece == len(step) - 1, np.inf, 1.0)
        share = np.clip(share, low, high)
        away = np.linalg.norm(points - line[piece] - share[:, None] * step[piece], axis=1)
        better = away < gap
        best[better] = (arc[piece] + share * length[piece])[better]
        gap = np.minimum(gap, away)
    return best


def _with_sections(
    line: np.ndarray, points: np.ndarray, weight: np.ndarray, along: np.ndarray, width: float, name: str
) -> CentreLine:
    """Directions carried along the line without turning about it, along the section's principal axes."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    apart = np.linalg.norm(line[0] - line[-1])
    if apart < 2.0 * width and apart < 0.5 * np.linalg.norm(np.diff(line, axis=0), axis=1).sum():
        raise ValueError(
            f"part '{name}': a rod that closes to a ring, expected two ends, or \"as\": \"solid\""
        )
    first = np.empty_like(line)
    first[0] = np.cross(tangent[0], np.eye(3)[np.abs(tangent[0]).argmin()])
    for k in range(len(line)):
        carried = first[max(k - 1, 0)]
        carried = carried - (carried @ tangent[k]) * tangent[k]
        first[k] = carried / np.linalg.norm(carried)
    second = np.cross(tangent, first)
    arc = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))]
    ones = np.ones((len(line), 2))
    plain = CentreLine(arc, line, first, second, ones, along.min(), along.max())
    place, one, two = plain.at(along)
    across = np.stack([((points - place) * d).sum(1) / (d**2).sum(1) for d in (one, two)], axis=1)
    if np.abs(across).max() > _ASIDE * width:
        raise ValueError(
            f"part '{name}': does not run along one line, expected a rod without branches that does not "
            'close to a ring, or "as": "solid"'
        )
    square = np.einsum("p,pa,pb->ab", weight, across, across)
    turn = np.linalg.eigh(square)[1][:, ::-1]
    turn[:, 1] *= np.sign(np.linalg.det(turn))
    across = across @ turn
    first, second = first * turn[0, 0] + second * turn[1, 0], first * turn[0, 1] + second * turn[1, 1]
    # Widths that cover all of the mesh within one of them along the line.
    widths = np.empty((len(arc), 2))
    for k, s in enumerate(arc):
        near = np.abs(np.clip(along, arc[0], arc[-1]) - s) <= max(width, arc[-1] / len(arc))
        widths[k] = 2.0 * np.abs(across[near]).max(axis=0, initial=0.0)
    return plain._replace(first=first, second=second, width=np.maximum(widths, 1e-6 * width))


def rod_chart(line: CentreLine, low: float, spacing: float, count: int) -> Chart:
    """Cells of a rod. low: where the first begins along the line [m]; spacing [m]; count: of cells."""
    place, first, second = line.at(low + spacing * (np.arange(count + 2) - 0.5))
    step = np.array([-1.0, 0.0, 1.0])
    across = step[:, None, None, None] * first + step[:, None, None] * second  # (3, 3, n, 3)
    return Chart("rod", np.moveaxis(place + across, 2, 0))
