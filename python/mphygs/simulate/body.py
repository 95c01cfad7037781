"""An object discretised for the total-Lagrangian transfer, with what holds it and what is seen of it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from mphygs import _core
from mphygs.capture.record import Sequence
from mphygs.scene.particles import (
    Quadrature,
    closest_material,
)

LANES = 8


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
