"""Closed part meshes filled with quadrature points that match the moments of every cell's material."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from mphygs.scene.columns import Segments, Strips, cut_axis, flat_planes, split_columns
from mphygs.scene.rays import checked_boxes, expand

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# A cell with less material than this share of its volume is left out; the rest of its part takes its volume.
SMALLEST_SHARE = 1e-4
# What a part may lose when all its free material is such slivers (left over beside a hold).
LARGEST_LOSS = 1e-2
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))  # (8, 3)


@dataclass(frozen=True)
class Quadrature:
    """Eight points for each block, a block being the free material of one part in one cell.

    Nodes stand at origin + i * spacing; cell i along an axis is the knot span [i - 1/2, i + 1/2] * spacing
    around node i, and touches the nodes i - 1, i, i + 1 of a quadratic B-spline.

    origin: (3,) [m]; spacing: (3,) [m]; node_shape: (3,) int, every touched node has an index in
    [0, node_shape); cell: (B, 3) int32; part: (B,) int32; points: (B, 8, 3) [m], inside their cell;
    volumes: (B, 8) [m^3]; part_volume: (P,) [m^3], each mesh whole; free_volume: (P,) [m^3], what is left
    of it without excluded boxes and without what an earlier part owns.
    """

    origin: np.ndarray
    spacing: np.ndarray
    node_shape: np.ndarray
    cell: np.ndarray
    part: np.ndarray
    points: np.ndarray
    volumes: np.ndarray
    part_volume: np.ndarray
    free_volume: np.ndarray


def fill(
    parts: Sequence[Part],
    *,
    spacing: float,
    exclude_boxes: np.ndarray | None = None,
    origin_offset: Sequence[float] | np.ndarray = (0.0, 0.0, 0.0),
    samples: int = 12,
) -> Quadrature:
    """Fill closed part meshes with quadrature points.

    spacing: of the grid [m]; exclude_boxes: (H, 2, 3) [m], held material to leave out; origin_offset: (3,),
    shift of the grid in cells (at 0 a cell boundary lies on the lower corner of the object's bounding box);
    samples: columns per cell along x and along y.

    The eight points of a block are mean + R s, s in {-1, 1}^3, each with an eighth of the volume, where R is
    the symmetric square root of the covariance of the block's material: they match its moments of order
    0, 1 and 2, and are the 2x2x2 Gauss points in a full cell. Unlike steps along the principal axes, R s
    depends on the shape alone also where two principal moments are equal, as they are in every full cell.
    In a cell with little material a point of that set can lie outside the cell; the spread along the
    offending axis is then shrunk about the unchanged mean until the point lies on the boundary.

    Moments are exact in height for each column and by midpoint across, the column's own width included;
    they are exact altogether for boxes along the axes. Volumes are scaled per part so that they add up to
    the volume of the mesh, less the sampled share that is excluded or owned by an earlier part.
    Raises ValueError on bad arguments, on meshes that are not closed and on parts too thin to be seen.
    """
    boxes = checked_boxes(exclude_boxes, "exclude_boxes")
    offset = _checked(parts, spacing, origin_offset, samples)
    vertices = np.concatenate([part.vertices for part in parts])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    share = offset - np.floor(offset)
    corner = low + (share - (share > 0.0)) * spacing
    cell_count = np.maximum(np.ceil((high - corner) / spacing - 1e-6), 1).astype(np.int64)
    x, y = (
        cut_axis(
            float(corner[axis]),
            spacing,
            int(cell_count[axis]),
            samples,
            _planes(parts, boxes, axis, spacing, samples * int(cell_count[axis]) // 2),
        )
        for axis in (0, 1)
    )
    segments = split_columns(parts, boxes, x, y)
    part_volume = np.array([mesh_volume(part) for part in parts])
    cell, part, share, mean, covariance = _moments(segments, x, y, corner, spacing, cell_count)
    sampled = np.bincount(part, weights=share, minlength=len(parts)) * spacing**3
    free_volume = part_volume * sampled / _seen(parts, segments.full_volume)
    kept = share >= SMALLEST_SHARE
    cell, part, share, mean, covariance = (values[kept] for values in (cell, part, share, mean, covariance))
    remaining = np.bincount(part, weights=share, minlength=len(parts))
    for number in np.flatnonzero((remaining == 0.0) & (sampled > LARGEST_LOSS * segments.full_volume)):
        raise ValueError(
            f"part '{parts[number].name}': no cell of {spacing} m holds {SMALLEST_SHARE} of its volume of "
            "free material, expected a finer spacing"
        )
    if len(cell) == 0:
        raise ValueError("exclude_boxes: they hold all material, expected some of it to be free")
    free_volume[remaining == 0.0] = 0.0
    volume = share * (free_volume / np.where(remaining > 0.0, remaining, 1.0))[part]
    points = mean[:, None] + np.einsum("kc,bac->bka", _CORNERS, _spread(mean, covariance))  # (B, 8, 3)
    centre = corner + (cell + 0.5) * spacing
    return Quadrature(
        origin=corner - 0.5 * spacing,
        spacing=np.full(3, float(spacing)),
        node_shape=cell_count + 2,
        cell=(cell + 1).astype(np.int32),
        part=part.astype(np.int32),
        points=centre[:, None] + points * spacing,
        volumes=np.repeat(volume[:, None] / 8.0, 8, axis=1),
        part_volume=part_volume,
        free_volume=free_volume,
    )


def mesh_volume(part: Part) -> float:
    """Volume enclosed by a closed mesh with outward faces [m^3], by the divergence theorem."""
    corners = (part.vertices - part.vertices.mean(axis=0))[part.faces]
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0)


def _checked(
    parts: Sequence[Part], spacing: float, origin_offset: Sequence[float] | np.ndarray, samples: int
) -> np.ndarray:
    if len(parts) == 0:
        raise ValueError("parts: got none, expected at least one closed mesh to fill")
    if not (np.isfinite(spacing) and spacing > 0.0):
        raise ValueError(f"spacing: got {spacing}, expected a positive length in metres")
    if samples < 1:
        raise ValueError(f"samples: got {samples}, expected at least one column per cell")
    offset = np.asarray(origin_offset, dtype=np.float64)
    if offset.shape != (3,) or not np.all(np.isfinite(offset)):
        raise ValueError(f"origin_offset: got {origin_offset}, expected three fractions of a cell")
    return offset


def _planes(parts: Sequence[Part], boxes: np.ndarray, axis: int, spacing: float, most: int) -> np.ndarray:
    """Where to cut columns: at every box, and at flat sides unless these are as dense as the columns."""
    flat = np.unique(np.concatenate([flat_planes(part, axis, 1e-9 * spacing) for part in parts]))
    return np.concatenate([flat if len(flat) <= most else flat[:0], boxes[:, :, axis].ravel()])


def _seen(parts: Sequence[Part], full_volume: np.ndarray) -> np.ndarray:
    for part, volume in zip(parts, full_volume, strict=True):
        if not volume > 0.0:
            raise ValueError(
                f"part '{part.name}': thinner than the columns that look for it, expected more samples"
            )
    return full_volume


def _moments(
    segments: Segments, x: Strips, y: Strips, corner: np.ndarray, spacing: float, cell_count: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Blocks with their share of a cell, mean and covariance, in cells about the middle of their cell."""
    low, high = (segments.low - corner[2]) / spacing, (segments.high - corner[2]) / spacing
    first = np.clip(np.floor(low), 0, cell_count[2] - 1).astype(np.int64)
    last = np.clip(np.ceil(high) - 1, first, cell_count[2] - 1).astype(np.int64)
    row, place = expand(last - first + 1)
    level = first[row] + place
    bottom = np.where(place == 0, low[row], level) - level - 0.5
    top = np.where(level == last[row], high[row], level + 1) - level - 0.5
    at_x, at_y = segments.x[row], segments.y[row]
    width = np.stack([x.width[at_x] / spacing, y.width[at_y] / spacing, top - bottom], axis=1)
    middle = np.stack(
        [
            (x.middle[at_x] - corner[0]) / spacing - x.cell[at_x] - 0.5,
            (y.middle[at_y] - corner[1]) / spacing - y.cell[at_y] - 0.5,
            0.5 * (bottom + top),
        ],
        axis=1,
    )
    part_count = len(segments.full_volume)
    key = (x.cell[at_x] * cell_count[1] + y.cell[at_y]) * cell_count[2] + level
    key, block = np.unique(key * part_count + segments.part[row], return_inverse=True)
    weight = width.prod(axis=1)

    def total(values: np.ndarray) -> np.ndarray:
        return np.bincount(block, weights=weight * values, minlength=len(key))

    share = total(np.ones(len(weight)))
    safe = np.where(share > 0.0, share, 1.0)
    mean = np.stack([total(middle[:, a]) / safe for a in range(3)], axis=1)
    spread = middle - mean[block]  # about the mean, so that no digits cancel in thin slivers
    covariance = np.empty((len(key), 3, 3))
    for a in range(3):
        for b in range(a, 3):
            own = width[:, a] ** 2 / 12.0 if a == b else 0.0
            covariance[:, a, b] = covariance[:, b, a] = total(spread[:, a] * spread[:, b] + own) / safe
    cell = np.stack(np.unravel_index(key // part_count, tuple(cell_count)), axis=1)
    return cell, key % part_count, share, mean, covariance


def _spread(mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Symmetric square roots of covariances (B, 3, 3), rows shrunk where mean + R s would leave the cell."""
    values, axes = np.linalg.eigh(covariance)
    root = np.einsum("bij,bj,bkj->bik", axes, np.sqrt(np.maximum(values, 0.0)), axes)
    reach = np.abs(root).sum(axis=2)  # (B, 3), furthest of the eight points along each axis
    room = np.maximum(0.5 - np.abs(mean), 0.0) * (1.0 - 1e-9)
    return root * np.minimum(1.0, room / np.maximum(reach, 1e-300))[:, :, None]
