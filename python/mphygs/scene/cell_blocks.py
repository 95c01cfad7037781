"""The material of one part in one cell: its moments, and eight points that have the same ones."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np

from mphygs.scene.columns import Segments, Strips
from mphygs.scene.rays import expand

# Cells that are made to fit are between these, in spacings.
SMALLEST, LARGEST = 0.75, 1.3
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))  # (8, 3)


class Grid(NamedTuple):
    """corner: lower one of the first cell (3,) [m]; spacing: (3,) [m]; count: (3,) cells."""

    corner: np.ndarray
    spacing: np.ndarray
    count: np.ndarray


def fitting(
    low: float, high: float, spacing: float, plane: float | None, least: int = 1
) -> tuple[float, float, int]:
    """Lower end, spacing and count of cells along one axis that cover [low, high].

    least: count of cells; plane: where a boundary between cells has to be [m]. Else the cells stand as far
    beyond the one end as beyond the other: not at all, unless the material is thinner than the least spacing.
    """
    inner = plane is not None and low - 1e-6 * spacing < plane < high + 1e-6 * spacing
    length = max(high - plane, plane - low) if inner else high - low
    count = max(least, round(length / spacing))
    if length > LARGEST * spacing * count:
        count += 1
    size = max(length / count, SMALLEST * spacing)
    if not inner:
        return 0.5 * (low + high - count * size), size, count
    below, above = (max(0, int(np.ceil(x / size - 1e-6))) for x in (plane - low, high - plane))
    return plane - below * size, size, below + above


class CellBlocks(NamedTuple):
    """Blocks of one grid. cell: (B, 3); part: (B,); share: (B,) of a cell's volume; volume: (B,) [m^3];
    points: (B, 8, 3) [m]; seen: (P,) volume of every part before anything was taken from it [m^3]."""

    cell: np.ndarray
    part: np.ndarray
    share: np.ndarray
    volume: np.ndarray
    points: np.ndarray
    seen: np.ndarray

    def only(self, part: int, number: int, part_count: int, free: float) -> CellBlocks:
        """The blocks of one part, which is number `number` of `part_count`; free: share of it that they are,
        for the grid reaches no further than they do."""
        mine, seen = self.part == part, np.zeros(part_count)
        seen[number] = self.volume[mine].sum() / free if free > 0.0 else self.seen[part]
        kept = [values[mine] for values in (self.cell, self.part, self.share, self.volume, self.points)]
        kept[1] = np.full(int(mine.sum()), number)
        return CellBlocks(*kept, seen)


def moments(
    segments: Segments,
    x: Strips,
    y: Strips,
    grid: Grid,
    measure: Callable[[np.ndarray], np.ndarray] | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Blocks with their share of a cell, mean and covariance, in cells about the middle of their cell.

    measure: what a cell's volume is multiplied with at places (n, 3) in cells from the corner of the grid.
    """
    corner, spacing, cell_count = grid
    low, high = (segments.low - corner[2]) / spacing[2], (segments.high - corner[2]) / spacing[2]
    first = np.clip(np.floor(low), 0, cell_count[2] - 1).astype(np.int64)
    last = np.clip(np.ceil(high) - 1, first, cell_count[2] - 1).astype(np.int64)
    row, place = expand(last - first + 1)
    level = first[row] + place
    bottom = np.where(place == 0, low[row], level) - level - 0.5
    top = np.where(level == last[row], high[row], level + 1) - level - 0.5
    at_x, at_y = segments.x[row], segments.y[row]
    width = np.stack([x.width[at_x] / spacing[0], y.width[at_y] / spacing[1], top - bottom], axis=1)
    middle = np.stack(
        [
            (x.middle[at_x] - corner[0]) / spacing[0] - x.cell[at_x] - 0.5,
            (y.middle[at_y] - corner[1]) / spacing[1] - y.cell[at_y] - 0.5,
            0.5 * (bottom + top),
        ],
        axis=1,
    )
    part_count = len(segments.full_volume)
    key = (x.cell[at_x] * cell_count[1] + y.cell[at_y]) * cell_count[2] + level
    key, block = np.unique(key * part_count + segments.part[row], return_inverse=True)
    weight = width.prod(axis=1)
    if measure is not None:
        weight = weight * measure(middle + 0.5 + np.stack([x.cell[at_x], y.cell[at_y], level], axis=1))

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(block, weights=weight * values, minlength=len(key))

    share = total(np.ones(len(weight)))
    safe = np.where(share > 0.0, share, 1.0)
    mean = np.stack([total(middle[:, a]) / safe for a in range(3)], axis=1)
    away = middle - mean[block]  # about the mean, so that no digits cancel in thin slivers
    covariance = np.empty((len(key), 3, 3))
    for a in range(3):
        for b in range(a, 3):
            own = width[:, a] ** 2 / 12.0 if a == b else 0.0
            covariance[:, a, b] = covariance[:, b, a] = total(away[:, a] * away[:, b] + own) / safe
    cell = np.stack(np.unravel_index(key // part_count, tuple(cell_count)), axis=1)
    return cell, key % part_count, share, mean, covariance


def spread(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Symmetric square roots of covariances (B, 3, 3), rows shrunk where mean + R s would leave the cell."""
    values, axes = np.linalg.eigh(covariance)
    root = np.einsum("bij,bj,bkj->bik", axes, np.sqrt(np.maximum(values, 0.0)), axes)
    reach = np.abs(root).sum(axis=2)  # (B, 3), furthest of the eight points along each axis
    room = np.maximum(0.5 - np.abs(mean), 0.0) * (1.0 - 1e-9)
    return root * np.minimum(1.0, room / np.maximum(reach, 1e-300))[:, :, None]
