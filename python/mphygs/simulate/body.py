"""An object discretised for the total-Lagrangian transfer, with what holds it and what is seen of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from mphygs import _core
from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence
from mphygs.scene.charts import Chart
from mphygs.scene.particles import (
    Quadrature,
    chosen_shape,
    closest_material,
    exposed_surface,
    fill,
    fill_each,
    hold_face,
    lay_chart,
    rods_doubled,
)
from mphygs.scene.slivers import merge_slivers
from mphygs.simulate.rows import constraint_rows

LANES = 8
# Cells filled less than this hand their material to a neighbour.
SMALLEST_SHARE = 0.1
# Cells filled less than this have shapes that their points do not see: springs hold those, but for parts that
# fill less of their cells on average: flowers with petals far thinner than a cell fitted worse with them.
SPARSE, THINNEST = 0.5, 1.0 / 3.0
# So do all cells of a bar that has so many to a section: no neighbour holds what their points do not see.
NARROW = 2


@dataclass(frozen=True, eq=False)
class Attachment:
    """Points carried by the body: x = anchor + sum N_a u_a + R offset, or rigidly by a hold.

    anchor: (M, 3) [m]; offset: (M, 3) [m]; cell: (M, 3) knot span on the part's grid; hold: (M,) index of
    the hold that carries the point, -1 for points carried by the material.
    """

    anchor: np.ndarray
    offset: np.ndarray
    cell: np.ndarray
    hold: np.ndarray
    part: np.ndarray


@dataclass(frozen=True, eq=False)
class Body:
    """One object at one spacing under one set of hold boxes.

    geometry: arrays for the core, cells and nodes numbered over the grids of all parts; quadrature: its
    points, cells as they stand in space; centroid: (P, 3) of every part [m];
    places: (K, 3) material points that effects at a place may use [m]; turn: of the sequence (see
    `mphygs.capture.record.Sequence`).
    """

    quadrature: Quadrature
    geometry: dict
    boxes: np.ndarray
    part_names: tuple[str, ...]
    centroid: np.ndarray
    parts: tuple = field(repr=False, default=())
    turn: np.ndarray | None = field(repr=False, default=None)

    def towards(self, vector: np.ndarray) -> np.ndarray:
        """A vector (3,) of the world, gravity's, in the frame that the sequence is told in."""
        return np.array(vector, float) if self.turn is None else np.asarray(vector, float) @ self.turn

    @property
    def block_count(self) -> int:
        """Number of blocks of material."""
        return len(self.quadrature.part)

    @property
    def free_block_count(self) -> int:
        """Blocks of material that no hold carries; they are the first."""
        return self.block_count

    @property
    def curved(self) -> bool:
        """Whether a part is a rod or a shell."""
        return any(chart is not None for chart in self.quadrature.charts)

    @property
    def held_points(self) -> np.ndarray:
        """(R, 3) places on the faces where holds grip [m]."""
        return self.geometry["row_target"][self.geometry["row_hold"] >= 0]

    @property
    def transfer(self) -> str:
        """Name of the transfer that it was discretised for."""
        return "total-lagrangian"

    @property
    def points(self) -> np.ndarray:
        """(B, 8, 3) quadrature points [m]."""
        return self.quadrature.points

    @property
    def point_part(self) -> np.ndarray:
        """(B, 8) part index of every point."""
        return np.repeat(self.quadrature.part[:, None], LANES, axis=1)

    @property
    def point_cell(self) -> np.ndarray:
        """(8 B, 3) knot span of every point on its part's grid."""
        return np.repeat(self.geometry["cell"], LANES, axis=0)

    def on_grid(self, cell: np.ndarray, part: np.ndarray | int) -> np.ndarray:
        """Cells or nodes (..., 3) of a part's grid, in the numbering over all grids."""
        numbered = np.array(cell)
        numbered[..., 0] += np.asarray(part) * self.geometry.get("grid_width", 0)
        return numbered

    def standing(self, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Cells (C, 3), numbered over all grids, as they are on their part's, and the parts (C,)."""
        width = self.geometry["grid_width"]
        part = cells[:, 0] // width if width else np.zeros(len(cells), int)
        return cells - np.stack([part * width, np.zeros_like(part), np.zeros_like(part)], axis=1), part

    @cached_property
    def cells_of_part(self) -> dict[int, np.ndarray]:
        """(C, 3) unique knot spans of its own grid that hold material of each part with any."""
        q = self.quadrature
        return {int(p): np.unique(q.cell[q.part == p], axis=0) for p in np.unique(q.part)}

    def nearest_cell(self, points: np.ndarray, part: np.ndarray | None = None) -> np.ndarray:
        """Knot span with material nearest to each point, on its part's grid.

        points: (M, 3) [m]; part: (M,) whose material carries each point, the nearest if not given ->
        (M, 3) int32. A point beside the material (on the surface, in a cell whose sliver was dropped) is
        carried by the polynomial of the nearest cell. Where all of a part is held, any other part serves.
        """
        cells = self.cells_of_part
        if len(cells) == 1:
            part = np.full(len(points), next(iter(cells)))
        elif part is None:
            part = closest_material(self.parts, points).part
        else:
            part = np.asarray(part)
        lost = ~np.isin(part, list(cells))
        if lost.any():
            nearest = cKDTree(self.quadrature.points.reshape(-1, 3)).query(points[lost])[1]
            part = part.copy()
            part[lost] = self.quadrature.part[nearest // LANES]
        result = np.empty((len(points), 3), np.int32)
        for p in np.unique(part):
            mine = part == p
            result[mine] = self.on_grid(self.nearest_of(int(p), points[mine]), p)
        return result

    def in_cells(self, points: np.ndarray, part: int) -> np.ndarray:
        """Points (..., 3) [m] in spacings of a part's grid, from its node 0."""
        return self.quadrature.in_cells(points, part)

    def nearest_of(self, part: int, points: np.ndarray) -> np.ndarray:
        """The cell of a part's grid with material that is nearest to each point (M, 3) [m]."""
        cells, position = self.cells_of_part[part], self.in_cells(points, part)
        result = np.empty((len(points), 3), np.int32)
        for start in range(0, len(points), 512):
            chunk = position[start : start + 512]
            # Distance to the span itself, not to its centre; ties go to the nearer centre.
            gap = np.abs(chunk[:, None] - cells[None])
            distance = (np.maximum(gap - 0.5, 0.0) ** 2).sum(-1) + 1e-6 * (gap**2).sum(-1)
            result[start : start + 512] = cells[distance.argmin(1)]
        return result

    def inside(self, box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which of all points (N,) stand in a box (2, 3) [m], and each one's share of the volume there.

        A box that misses all material gets the nearest point. What a hold carries is left out.
        """
        free = slice(0, LANES * self.free_block_count)
        points, volumes = self.quadrature.points.reshape(-1, 3)[free], self.quadrature.volumes.ravel()
        within = np.zeros(len(volumes), bool)
        within[free] = ((points >= box[0]) & (points <= box[1])).all(1)
        if not within.any():
            within[np.abs(points - box.mean(0)).sum(1).argmin()] = True
        return within, volumes[within] / volumes[within].sum()

    def attach(self, points: np.ndarray) -> Attachment:
        """Attach measured points given at rest, (M, 3) [m]."""
        material = closest_material(self.parts, points)
        part, anchor, offset = material.part, material.anchor, material.offset
        hold = np.full(len(points), -1)
        for index, box in enumerate(self.boxes):
            hold[((anchor >= box[0] - 1e-9) & (anchor <= box[1] + 1e-9)).all(1)] = index
        return Attachment(anchor, offset, self.nearest_cell(anchor, part), hold, part)


def hold_boxes(sequence: Sequence) -> np.ndarray:
    """(H, 2, 3) boxes of what holds the object in a sequence [m]."""
    return np.array([hold.box for hold in sequence.held]).reshape(-1, 2, 3)


def discretise(
    capture: Capture,
    boxes: np.ndarray,
    spacing: float,
    *,
    places: np.ndarray | None = None,
    fitting: bool = True,
) -> Body:
    """Discretise a capture's parts for given hold boxes.

    boxes: (H, 2, 3) [m]; spacing: of the grids [m]; places: (K, 3) points for effects at a place [m];
    fitting: every part's grid fits its material (see `mphygs.scene.quadrature.fill_each`), else all stand
    alike.
    Raises ValueError where a hold touches no free material or the spacing misses a part.
    """
    parts = capture.parts
    faces = [
        hold_face(parts, box, spacing=spacing, other_boxes=np.delete(boxes, h, axis=0))
        for h, box in enumerate(boxes)
    ]
    excluded = boxes if len(boxes) else None
    # A held face on the boundary between two cells leaves no slivers of material beside it.
    if fitting:
        gripped = {
            (int(p), face.axis): face.coordinate for group in faces for face in group for p in set(face.part)
        }
        charts = [
            lay_chart(part, spacing, [f.points[f.part == p] for group in faces for f in group])
            for p, part in enumerate(parts)
        ]
        charts = charts if any(chart is not None for chart in charts) else []
        quadrature = fill_each(parts, spacing=spacing, exclude_boxes=excluded, planes=gripped, charts=charts)
    else:
        for part in parts:
            if (shape := chosen_shape(part, spacing)[0]) != "solid":
                raise ValueError(
                    f"part '{part.name}': a {shape} is simulated by the total-Lagrangian transfer alone, "
                    'expected --transfer total-lagrangian, or "as": "solid"'
                )
        low = np.min([part.vertices.min(0) for part in parts], axis=0)
        offset = np.zeros(3)
        for group in faces:
            for face in group:
                offset[face.axis] = ((face.coordinate - low[face.axis]) / spacing) % 1.0
        quadrature = fill(parts, spacing=spacing, exclude_boxes=excluded, origin_offset=offset)
    quadrature = rods_doubled(merge_slivers(quadrature, share=SMALLEST_SHARE))
    centroid = np.array(
        [
            np.average(
                quadrature.points[quadrature.part == p].reshape(-1, 3),
                axis=0,
                weights=quadrature.volumes[quadrature.part == p].ravel(),
            )
            if (quadrature.part == p).any()
            else part.vertices.mean(0)
            for p, part in enumerate(parts)
        ]
    )
    # Every part has nodes of its own: one spline over a joint of stiff and soft would stiffen the soft side
    # for a spacing around. Beyond its nodes two columns stay free, so that no stencil reaches the next grid.
    width = int(quadrature.node_shape[0]) + 2 if len(parts) > 1 else 0
    numbered = quadrature.cell.copy()
    numbered[:, 0] += quadrature.part * width
    filled = quadrature.filled
    cells = np.bincount(quadrature.part, minlength=len(parts))
    thick = np.bincount(quadrature.part, filled, len(parts)) > THINNEST * cells
    narrow = np.array(
        [
            quadrature.chart(p) is None and _section(quadrature.cell[quadrature.part == p]) <= NARROW
            for p in range(len(parts))
        ]
    )
    sparse = (filled < SPARSE) | narrow[quadrature.part]
    geometry = {
        "origin": quadrature.origins,
        "spacing": quadrature.spacings,
        "grid_width": width,
        "cell": numbered,
        "part": quadrature.part,
        "points": quadrature.points,
        "sparse": np.where(sparse & thick[quadrature.part], filled, 0.0),
        "part_count": len(parts),
    }
    geometry.update(_curved_nodes(quadrature.charts, width))
    body = Body(quadrature, geometry, boxes, tuple(p.name for p in parts), centroid, parts)
    geometry.update(_surface(body, boxes, spacing))
    geometry.update(constraint_rows(body, faces, spacing))
    geometry["hold_centre"] = boxes.mean(axis=1)
    if places is not None and len(places):
        geometry["places"] = np.asarray(places, float)
        geometry["place_cell"] = body.nearest_cell(np.asarray(places, float))
    return body


def _curved_nodes(charts: tuple[Chart | None, ...], width: int) -> dict:
    """Where nodes stand that a chart has, numbered over all grids."""
    curved = [(number, chart) for number, chart in enumerate(charts) if chart is not None]
    if not curved:
        return {}
    nodes = [chart.nodes + [number * width, 0, 0] for number, chart in curved]
    return {
        "curved_node": np.concatenate(nodes).astype(np.int32),
        "curved_position": np.concatenate([chart.control.reshape(-1, 3) for _, chart in curved]),
    }


def _section(cell: np.ndarray) -> int:
    """Cells of a part across its longest axis. cell: (B, 3) its cells."""
    if len(cell) == 0:
        return 0
    count = np.ptp(cell, axis=0) + 1
    return int(np.prod(count) // count.max())


def _surface(body: Body, boxes: np.ndarray, spacing: float) -> dict:
    """Exposed surface, one block to a cell: the samples in each eighth of it stand together in one lane.

    Area and centroid of every eighth are kept, so forces that vary within a quarter of a spacing are
    averaged there; lanes without surface have no area.
    """
    samples = exposed_surface(body.parts, max_edge=spacing / 2, exclude_boxes=boxes if len(boxes) else None)
    if not len(samples.area):
        return {}
    cells, block = np.unique(
        body.nearest_cell(samples.points, samples.part), axis=0, return_inverse=True
    )
    block = block.ravel()
    centre = _centres(body, cells)
    above = samples.points > centre[block]
    for part, chart in enumerate(body.quadrature.charts):
        if chart is not None and (mine := samples.part == part).any():
            above[mine] = chart.to_cells(samples.points[mine]) > body.standing(cells[block[mine]])[0]
    octant = above @ np.array([4, 2, 1])
    lane = block * LANES + octant
    area = np.bincount(lane, samples.area, minlength=LANES * len(cells))
    sums = [np.bincount(lane, samples.area * samples.points[:, c], minlength=len(area)) for c in range(3)]
    points = np.stack(sums, axis=1) / np.where(area > 0, area, 1.0)[:, None]
    points = np.where((area > 0)[:, None], points, np.repeat(centre, LANES, axis=0))
    return {
        "surface_cell": cells.astype(np.int32),
        "surface_points": points.reshape(-1, LANES, 3),
        "surface_area": area.reshape(-1, LANES),
    }


def _centres(body: Body, cells: np.ndarray) -> np.ndarray:
    """Middle of cells (C, 3), numbered over all grids [m]."""
    own, part = body.standing(cells)
    q = body.quadrature
    centre = q.origins[part] + own * q.spacings[part]
    for number, chart in enumerate(q.charts):
        if chart is not None and (mine := part == number).any():
            centre[mine] = chart.to_space(own[mine].astype(float))
    return centre


def with_places(body: Body, spots: np.ndarray) -> Body:
    """The body with effects at other places, (K, 3) [m]."""
    if not len(spots):
        return body
    return replace(body, geometry=body.geometry | {"places": spots, "place_cell": body.nearest_cell(spots)})


def core_model(
    body: Body, *, active: tuple[str, ...], dtype: type, law: str, threads: int, memory_budget: int
) -> object:
    """The compiled model of a body with given core effects switched on."""
    kind = _core.TotalLagrangianFloat32 if dtype == np.float32 else _core.TotalLagrangianFloat64
    settings = {"active": list(active), "law": law, "threads": threads, "memory_budget": memory_budget}
    extent = float(np.linalg.norm(np.ptp(body.quadrature.points.reshape(-1, 3), axis=0)))
    settings["displacement_limit"] = 100.0 * extent + 100.0
    return kind(body.geometry, settings)
