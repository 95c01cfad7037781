"""Closed part meshes filled with quadrature points that match the moments of every cell's material."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from mphygs.capture.meshes import enclosed_volume
from mphygs.scene.cell_blocks import CORNERS, CellBlocks, Grid, fitting, moments, spread
from mphygs.scene.columns import Strips, cut_axis, flat_planes, split_columns
from mphygs.scene.curved_quadrature import fill_curved
from mphygs.scene.rays import checked_boxes

if TYPE_CHECKING:
    from mphygs.capture.format import Part
    from mphygs.scene.curved_charts import Chart

# A cell with less material than this share of its volume is left out; the rest of its part takes its volume.
SMALLEST_SHARE = 1e-4
# What a part may lose when all its free material is such slivers (left over beside a hold).
LARGEST_LOSS = 1e-2


@dataclass(frozen=True)
class Quadrature:
    """Eight points for each block, a block being the free material of one part in one cell.

    Nodes stand at origin + i * spacing; cell i along an axis is the knot span [i - 1/2, i + 1/2] * spacing
    around node i, and touches the nodes i - 1, i, i + 1 of a quadratic B-spline.

    origin, spacing: of the grid, (3,) [m], or of every part's own grid, (P, 3) [m]; node_shape: (3,) int,
    every touched node has an index in [0, node_shape); cell: (B, 3) int32; part: (B,) int32; points:
    (B, 8, 3) [m], inside their cell; volumes: (B, 8) [m^3]; part_volume: (P,) [m^3], each mesh whole;
    free_volume: (P,) [m^3], what is left of it without excluded boxes and without what an earlier part owns;
    charts: of every part, None where its grid is a lattice, or empty. What has a chart has no origin, and
    for its spacing the mean edges of its cells.
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
    charts: tuple[Chart | None, ...] = ()

    def chart(self, part: int) -> Chart | None:
        """The curved grid of a part, if it has one."""
        return self.charts[part] if self.charts else None

    def in_cells(self, points: np.ndarray, part: int) -> np.ndarray:
        """Places (..., 3) [m] in cells of a part's grid, from its node 0."""
        if chart := self.chart(part):
            return chart.to_cells(points)
        return (points - self.origins[part]) / self.spacings[part]

    def from_cells(self, position: np.ndarray, part: int) -> np.ndarray:
        """Places (M, 3) [m] of positions (M, 3) in cells of a part's grid."""
        if chart := self.chart(part):
            return chart.to_space(position)
        return self.origins[part] + position * self.spacings[part]

    @cached_property
    def cell_volume(self) -> np.ndarray:
        """(B,) volume of each block's cell [m^3]."""
        volume = self.spacings.prod(1)[self.part]
        for number, chart in enumerate(self.charts):
            if chart is not None and (mine := self.part == number).any():
                volume[mine] = np.abs(np.linalg.det(chart.jacobian(self.cell[mine].astype(float))))
        return volume

    @property
    def origins(self) -> np.ndarray:
        """(P, 3) of every part's grid [m]."""
        return np.broadcast_to(self.origin, (len(self.part_volume), 3))

    @property
    def spacings(self) -> np.ndarray:
        """(P, 3) of every part's grid [m]."""
        return np.broadcast_to(self.spacing, (len(self.part_volume), 3))

    @property
    def filled(self) -> np.ndarray:
        """(B,) share of its cell that the material of each block and of those beside it fills."""
        place = np.concatenate([self.part[:, None], self.cell], axis=1)
        which = np.unique(place, axis=0, return_inverse=True)[1].ravel()
        return np.bincount(which, self.volumes.sum(1))[which] / self.cell_volume


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
    grid = Grid(corner, np.full(3, float(spacing)), cell_count)
    return _checked_blocks(parts, (_blocks(parts, boxes, grid, samples),), grid.spacing, grid.corner)


def fill_each(
    parts: Sequence[Part],
    *,
    spacing: float,
    exclude_boxes: np.ndarray | None = None,
    planes: Mapping[tuple[int, int], float] | None = None,
    samples: int = 12,
    charts: Sequence[Chart | None] = (),
) -> Quadrature:
    """As `fill`, every part on a grid of its own that fits its free material, or on a chart that is given.

    spacing: of the grids, along each axis as near to it as makes a whole number of cells [m]; planes: for
    (part, axis) a coordinate where a boundary between cells has to lie, as where a hold grips [m].
    A bar's cells are full, and what cells leave out of a symmetric section is as symmetric as the section.
    Cells are numbered from 1 on every grid.
    """
    boxes = checked_boxes(exclude_boxes, "exclude_boxes")
    _checked(parts, spacing, np.zeros(3), samples)
    found, grids = [], []
    for number, part in enumerate(parts):
        # What an earlier part owns is its own.
        near = [p for p in parts[:number] if _overlap(p, part)]
        if charts and (chart := charts[number]) is not None:
            found.append(fill_curved(part, number, len(parts), chart, boxes, near, samples))
            edges = np.linalg.norm(chart.jacobian(np.array([0.5 * (chart.count + 1)])), axis=1)[0]
            grids.append(Grid(0.5 * edges, edges, chart.count))
            continue
        low, high, free = _free_extent([*near, part], boxes, spacing, samples)
        grid = _fitting_grid(low, high, spacing, [(planes or {}).get((number, a)) for a in range(3)])
        blocks = _blocks([*near, part], boxes, grid, samples)
        found.append(blocks.only(len(near), number, len(parts), free))
        grids.append(grid)
    size, corner = (np.stack([getattr(g, name) for g in grids]) for name in ("spacing", "corner"))
    filled = _checked_blocks(parts, found, size, corner)
    shapes = [filled.node_shape, *(chart.control.shape[:3] for chart in charts if chart is not None)]
    return replace(filled, node_shape=np.max(shapes, axis=0), charts=tuple(charts))


def _fitting_grid(
    low: np.ndarray, high: np.ndarray, spacing: float, planes: Sequence[float | None]
) -> Grid:
    """The cells that cover a box, see `fitting`; a column of single cells becomes one of pairs: its points
    do not see all shapes of the splines, and no neighbour holds those."""
    cells = [fitting(low[a], high[a], spacing, planes[a]) for a in range(3)]
    single = [a for a in range(3) if cells[a][2] == 1]
    if len(single) > 1:
        widest = max(single, key=lambda a: high[a] - low[a])
        cells[widest] = fitting(low[widest], high[widest], spacing, planes[widest], least=2)
    corner, size, count = (np.array(values) for values in zip(*cells, strict=True))
    return Grid(corner, size, count)


def _overlap(one: Part, other: Part) -> bool:
    return bool(
        np.all(one.vertices.min(axis=0) < other.vertices.max(axis=0))
        and np.all(other.vertices.min(axis=0) < one.vertices.max(axis=0))
    )


def _free_extent(
    parts: Sequence[Part], boxes: np.ndarray, spacing: float, samples: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Lower and upper corner of the last part's free material [m], of all of it where none is free, and how
    much of its volume is free."""
    low, high = parts[-1].vertices.min(axis=0), parts[-1].vertices.max(axis=0)
    count = np.maximum(np.ceil((high - low) / spacing - 1e-6), 1).astype(np.int64)
    x, y = _strips(parts, boxes, Grid(low, np.full(3, spacing), count), samples)
    segments = split_columns(parts, boxes, x, y)
    mine = segments.part == len(parts) - 1
    if not mine.any():
        return low, high, 0.0
    at_x, at_y = segments.x[mine], segments.y[mine]
    least = np.array([x.low[at_x].min(), y.low[at_y].min(), segments.low[mine].min()])
    most = np.array([x.high[at_x].max(), y.high[at_y].max(), segments.high[mine].max()])
    volume = (x.width[at_x] * y.width[at_y] * (segments.high - segments.low)[mine]).sum()
    return np.maximum(least, low), np.minimum(most, high), float(volume / segments.full_volume[-1])


def _strips(parts: Sequence[Part], boxes: np.ndarray, grid: Grid, samples: int) -> tuple[Strips, Strips]:
    return tuple(
        cut_axis(
            float(grid.corner[axis]),
            float(grid.spacing[axis]),
            int(grid.count[axis]),
            samples,
            _planes(parts, boxes, axis, float(grid.spacing[axis]), samples * int(grid.count[axis]) // 2),
        )
        for axis in (0, 1)
    )


def _blocks(parts: Sequence[Part], boxes: np.ndarray, grid: Grid, samples: int) -> CellBlocks:
    x, y = _strips(parts, boxes, grid, samples)
    segments = split_columns(parts, boxes, x, y)
    cell, part, share, mean, covariance = moments(segments, x, y, grid)
    points = mean[:, None] + np.einsum("kc,bac->bka", CORNERS, spread(mean, covariance))  # (B, 8, 3)
    centre = grid.corner + (cell + 0.5) * grid.spacing
    volume = share * grid.spacing.prod()
    placed = centre[:, None] + points * grid.spacing
    return CellBlocks(cell, part, share, volume, placed, segments.full_volume)


def _checked_blocks(
    parts: Sequence[Part], found: Sequence[CellBlocks], spacing: np.ndarray, corner: np.ndarray
) -> Quadrature:
    """All blocks, with the volumes of the meshes. spacing, corner: (3,), or (P, 3) of own grids [m]."""
    seen = _seen(parts, np.sum([blocks.seen for blocks in found], axis=0))
    cell, part, share, volume, points = (np.concatenate(x) for x in zip(*(b[:5] for b in found), strict=True))
    part_volume = np.array([enclosed_volume(part.vertices, part.faces) for part in parts])
    sampled = np.bincount(part, weights=volume, minlength=len(parts))
    free_volume = part_volume * sampled / seen
    kept = share >= SMALLEST_SHARE
    cell, part, volume, points = cell[kept], part[kept], volume[kept], points[kept]
    remaining = np.bincount(part, weights=volume, minlength=len(parts))
    for number in np.flatnonzero((remaining == 0.0) & (sampled > LARGEST_LOSS * seen)):
        raise ValueError(
            f"part '{parts[number].name}': no cell of {float(np.max(spacing))} m holds {SMALLEST_SHARE} of "
            "its volume of free material, expected a finer spacing"
        )
    if len(cell) == 0:
        raise ValueError("exclude_boxes: they hold all material, expected some of it to be free")
    free_volume[remaining == 0.0] = 0.0
    volume = volume * (free_volume / np.where(remaining > 0.0, remaining, 1.0))[part]
    return Quadrature(
        origin=corner - 0.5 * spacing,
        spacing=spacing,
        node_shape=np.max([b.cell.max(axis=0, initial=0) for b in found], axis=0) + 3,
        cell=(cell + 1).astype(np.int32),
        part=part.astype(np.int32),
        points=points,
        volumes=np.repeat(volume[:, None] / 8.0, 8, axis=1),
        part_volume=part_volume,
        free_volume=free_volume,
    )


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
