"""A force field with few numbers: constant in coarse cells, piecewise linear in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.simulate.body import Body

# Cells of the whole object, at least one a part, and frames between two values over time at least.
CELLS, FRAMES = 24, 3
# Unknowns at most: cells times values over time times three.
UNKNOWNS = 1600
LLOYD_ITERATIONS = 8


@dataclass(frozen=True, eq=False)
class ForceBasis:
    """Force per mass of C cells at H times, (H, C, 3) [N/kg], and the forces on N nodes that it stands for.

    spread: (N, C) mass of each cell at each node [kg]; hats: (T, H), row t of the interval that
    ends at frame t;
    center: (C, 3) [m] at rest; part: (C,) index; mass: (C,) [kg]; point_cell: (Q,) cell of every quadrature
    point; roughness: (H C, H C) matrix W of the squared size per component; a field of 1 N/kg has 1.
    """

    spread: np.ndarray
    hats: np.ndarray
    center: np.ndarray
    part: np.ndarray
    mass: np.ndarray
    point_cell: np.ndarray
    roughness: np.ndarray

    @property
    def shape(self) -> tuple[int, int, int]:
        """Of the values: (H, C, 3)."""
        return self.hats.shape[1], len(self.part), 3

    def over_time(self, values: np.ndarray) -> np.ndarray:
        """(H, C, 3) -> (T, C, 3) [N/kg] over the intervals that end at each frame."""
        return np.tensordot(self.hats, values, axes=1)

    def forces(self, values: np.ndarray) -> np.ndarray:
        """(H, C, 3) [N/kg] -> (T, N, 3) [N]."""
        return np.einsum("nc,fcd->fnd", self.spread, self.over_time(values))

    def pulled(self, force_bar: np.ndarray) -> np.ndarray:
        """(T', N, 3) gradient by the node forces of the first T' frames -> (H, C, 3) by the values."""
        cells = np.einsum("nc,fnd->fcd", self.spread, force_bar)
        return np.tensordot(self.hats[: len(force_bar)].T, cells, axes=1)

    def square(self, values: np.ndarray) -> float:
        """|f|_W^2 [N^2/kg^2]."""
        flat = values.reshape(-1, 3)
        return float(np.einsum("ic,ij,jc->", flat, self.roughness, flat))


def force_basis(
    body: Body, mass: np.ndarray, node: np.ndarray, weight: np.ndarray, nodes: int, moving: np.ndarray,
    *, cells: int = CELLS, frames: int = FRAMES,
) -> ForceBasis:  # fmt: skip
    """Coarse cells of a body and hat functions over the frames in which it moves.

    mass: (B, 8) [kg]; node, weight: (8 B, 27) of every quadrature point; nodes: N; moving: (F,) frames at
    which an interval ends; frames: from one hat to the next, more where there would be too many unknowns.
    """
    point_mass = mass.ravel()
    points, parts = body.quadrature.points.reshape(-1, 3), body.point_part.ravel()
    cell = coarse_cells(points, parts, point_mass, cells)
    count = int(cell.max()) + 1
    spread = np.zeros((nodes, count))
    np.add.at(spread, (node, cell[:, None]), weight * point_mass[:, None])
    frames = max(frames, -(-3 * count * len(moving) // UNKNOWNS))
    hats = hat_functions(moving, frames)
    cell_mass = np.bincount(cell, point_mass)
    moments = [np.bincount(cell, point_mass * points[:, c]) for c in range(3)]
    center = np.stack(moments, axis=1) / cell_mass[:, None]
    part = np.array([parts[cell == c][0] for c in range(count)])
    roughness = np.kron(_over_time(hats[moving]), _over_space(spread, part, cell_mass))
    return ForceBasis(spread, hats, center, part, cell_mass, cell, roughness)


def coarse_cells(points: np.ndarray, part: np.ndarray, mass: np.ndarray, count: int) -> np.ndarray:
    """(Q,) cell of every point: clusters inside the parts, their number in proportion to mass^(2/3).

    Lloyd's algorithm from points far apart; the same points give the same cells.
    """
    share = np.bincount(part, mass) ** (2.0 / 3.0)
    cell, first = np.zeros(len(points), int), 0
    for p in np.unique(part):
        mine = np.flatnonzero(part == p)
        wanted = min(max(1, round(count * share[p] / share.sum())), len(mine))
        x = points[mine]
        seeds = [int(np.linalg.norm(x - np.average(x, axis=0, weights=mass[mine]), axis=1).argmax())]
        distance = np.linalg.norm(x - x[seeds[0]], axis=1)
        while len(seeds) < wanted:
            seeds.append(int(distance.argmax()))
            distance = np.minimum(distance, np.linalg.norm(x - x[seeds[-1]], axis=1))
        center = x[seeds]
        for _ in range(LLOYD_ITERATIONS):
            nearest = np.linalg.norm(x[:, None] - center[None], axis=2).argmin(1)
            center = np.array(
                [
                    np.average(x[nearest == c], axis=0, weights=mass[mine][nearest == c])
                    if (nearest == c).any()
                    else center[c]
                    for c in range(len(center))
                ]
            )
        _, nearest = np.unique(nearest, return_inverse=True)
        cell[mine] = first + nearest
        first += int(nearest.max()) + 1
    return cell


def hat_functions(moving: np.ndarray, frames: int) -> np.ndarray:
    """(T, H) linear interpolation between values about `frames` apart over the moving frames, T - 1 the last
    of them; constant before."""
    span = len(moving)
    count = max(2, -(-span // frames) + 1)
    at = (np.arange(moving[-1] + 1) - moving[0] + 0.5) / span * (count - 1)
    return np.maximum(0.0, 1.0 - np.abs(np.maximum(at, 0.0)[:, None] - np.arange(count)))


def _over_time(hats: np.ndarray) -> np.ndarray:
    """(H, H): mean square over time, and that of the change from one value to the next."""
    count = hats.shape[1]
    difference = np.diff(np.eye(count), axis=0)
    return hats.T @ hats / len(hats) + difference.T @ difference / count


def _over_space(spread: np.ndarray, part: np.ndarray, mass: np.ndarray) -> np.ndarray:
    """(C, C): mean square over the mass, and that of the jumps to neighbours in the same part."""
    at_node = spread.sum(1, keepdims=True)
    overlap = spread.T @ (spread / np.where(at_node > 0.0, at_node, 1.0))
    overlap = np.where(part[:, None] == part[None], overlap, 0.0)
    np.fill_diagonal(overlap, 0.0)
    return (np.diag(mass) + np.diag(overlap.sum(1)) - overlap) / mass.sum()
