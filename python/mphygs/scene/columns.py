"""The solid as thin upright columns: for every column the stretches of height each part owns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mphygs.scene.rays import crossings, expand

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# Rays leave the middle of their column by this share of its width (two irrational numbers, so that they meet
# no edge of a mesh drawn on the same lattice); a second and third try go elsewhere.
_SHIFT = 1e-7 * np.sqrt([[2.0, 3.0], [5.0, 7.0], [11.0, 13.0]]) * [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0]]
_MOST_COLUMNS = 1 << 26

Events = tuple[np.ndarray, np.ndarray, np.ndarray]  # column, height [m], number of the part or box


@dataclass(frozen=True)
class Strips:
    """One axis cut into strips that never straddle a cell boundary.

    low, high: (n,) [m]; cell: (n,) int, the cell each strip lies in, counted from 0.
    """

    low: np.ndarray
    high: np.ndarray
    cell: np.ndarray

    @property
    def middle(self) -> np.ndarray:
        """Middles of the strips."""
        return 0.5 * (self.low + self.high)

    @property
    def width(self) -> np.ndarray:
        """Widths of the strips."""
        return self.high - self.low


@dataclass(frozen=True)
class Segments:
    """Stretches of columns, each inside one part.

    x, y: (S,) int, strip of the column on either axis; low, high: (S,) heights [m]; part: (S,) int;
    full_volume: (P,) [m^3], volume of the columns inside each part before anything was taken from it.
    """

    x: np.ndarray
    y: np.ndarray
    low: np.ndarray
    high: np.ndarray
    part: np.ndarray
    full_volume: np.ndarray


def cut_axis(low: float, spacing: float, cell_count: int, samples: int, planes: np.ndarray) -> Strips:
    """Strips at most spacing / samples wide, with a cut at every cell boundary and at every given plane.

    low: start of cell 0 [m]; spacing [m]; planes: coordinates [m] where the solid has a flat side, so that no
    strip is half full there.
    """
    cells = low + spacing * np.arange(cell_count + 1)
    tolerance = 1e-9 * spacing
    planes = np.unique(planes)
    planes = planes[(planes > cells[0] + tolerance) & (planes < cells[-1] - tolerance)]
    planes = planes[np.abs(planes - low - spacing * np.round((planes - low) / spacing)) > tolerance]
    if len(planes):
        planes = planes[np.concatenate([[True], np.diff(planes) > tolerance])]
    cuts = np.sort(np.concatenate([cells, planes]))
    pieces = np.ceil(np.diff(cuts) / spacing * samples - 1e-6).astype(np.int64)
    row, place = expand(pieces)
    step = np.diff(cuts)[row] / pieces[row]
    edges = np.concatenate([cuts[row] + place * step, cuts[-1:]])
    middle = 0.5 * (edges[1:] + edges[:-1])
    cell = np.clip(np.floor((middle - low) / spacing).astype(np.int64), 0, cell_count - 1)
    return Strips(low=edges[:-1], high=edges[1:], cell=cell)


def flat_planes(part: Part, axis: int, tolerance: float) -> np.ndarray:
    """Coordinates along an axis [m] where a mesh has triangles square to it, to within tolerance [m]."""
    coordinate = part.vertices[part.faces, axis]
    flat = np.ptp(coordinate, axis=1) <= tolerance
    return np.unique(coordinate[flat, 0])


def split_columns(parts: Sequence[Part], boxes: np.ndarray, x: Strips, y: Strips) -> Segments:
    """The stretches of every column that belong to a part and to no box; where parts overlap the first owns.

    boxes: (H, 2, 3) [m]. A column's heights are those of the ray in its middle.
    Raises ValueError if a mesh is not closed, or if there are too many columns.
    """
    if len(x.low) * len(y.low) > _MOST_COLUMNS:
        raise ValueError(
            f"{len(x.low)} x {len(y.low)} columns are too many (limit {_MOST_COLUMNS}): "
            "the spacing is too fine for an object of this size"
        )
    events = [_part_events(part, x, y, number) for number, part in enumerate(parts)]
    events += [_box_events(box, x, y, len(parts) + number) for number, box in enumerate(boxes)]
    column, height, owner = (np.concatenate(values) for values in zip(*events, strict=True))
    order = np.lexsort((height, column))
    column, height, owner = column[order], height[order], owner[order]
    # Every column holds an even number of events of each kind, so a running parity closes with the column.
    low, length = height[:-1], np.diff(height)
    column = column[:-1]
    volume = length * x.width[column // len(y.low)] * y.width[column % len(y.low)]
    full = np.zeros(len(parts))
    part = np.full(len(column), -1, dtype=np.int64)
    for number in range(len(parts)):
        active = np.cumsum(owner == number)[:-1] % 2 == 1
        full[number] = volume[active].sum()
        part[active & (part < 0)] = number
    for number in range(len(boxes)):
        part[np.cumsum(owner == len(parts) + number)[:-1] % 2 == 1] = -1
    kept = (part >= 0) & (length > 0.0)
    return Segments(
        x=column[kept] // len(y.low),
        y=column[kept] % len(y.low),
        low=low[kept],
        high=low[kept] + length[kept],
        part=part[kept],
        full_volume=full,
    )


def _part_events(part: Part, x: Strips, y: Strips, number: int) -> Events:
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    x_range = np.flatnonzero((x.high >= low[0]) & (x.low <= high[0]))
    y_range = np.flatnonzero((y.high >= low[1]) & (y.low <= high[1]))
    column = (x_range[:, None] * len(y.low) + y_range).ravel()
    found_column, found_height = [], []
    for shift in _SHIFT:
        at_x = (x.middle + shift[0] * x.width)[column // len(y.low)]
        at_y = (y.middle + shift[1] * y.width)[column % len(y.low)]
        ray, height = crossings(part.vertices, part.faces, np.stack([at_x, at_y], axis=1))
        odd = np.bincount(ray, minlength=len(column)) % 2 == 1
        good = ~odd[ray]
        found_column.append(column[ray[good]])
        found_height.append(height[good])
        column = column[odd]
        if len(column) == 0:
            break
    else:
        raise ValueError(
            f"part '{part.name}': {len(column)} vertical lines enter the mesh without leaving it, "
            "expected a closed surface"
        )
    heights = np.concatenate(found_height)
    return np.concatenate(found_column), heights, np.full(len(heights), number)


def _box_events(box: np.ndarray, x: Strips, y: Strips, number: int) -> Events:
    x_range = np.flatnonzero((x.middle > box[0, 0]) & (x.middle < box[1, 0]))
    y_range = np.flatnonzero((y.middle > box[0, 1]) & (y.middle < box[1, 1]))
    column = (x_range[:, None] * len(y.low) + y_range).ravel()
    heights = np.concatenate([np.full(len(column), box[0, 2]), np.full(len(column), box[1, 2])])
    return np.tile(column, 2), heights, np.full(len(heights), number)
