"""An object as particles for the MLS-MPM transfer: its free material, and what clamps it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from mphygs.capture.format import Capture
from mphygs.scene.particles import HoldFace, Quadrature, exposed_surface, hold_face, inside
from mphygs.simulate.body import LANES, Body
from mphygs.simulate.discretisation import discretise
from mphygs.simulate.held_material import enclosed

# Cells behind the face of a clamp that share a node of the quadratic splines with the free material.
REACH = 2
# A full cell's points and those of its sides (Gauss), in cells about the middle.
_GAUSS = 0.5 / np.sqrt(3.0)


@dataclass(frozen=True, eq=False)
class ParticleBody(Body):
    """Particles are the quadrature's points, block after block: those of the free material first, the same
    as the total-Lagrangian transfer's on `grid`, then those that the holds carry."""

    grid: Body = field(repr=False, kw_only=True)

    @property
    def free_block_count(self) -> int:
        """Number of the grid's blocks: a hold carries none of them."""
        return self.grid.block_count

    @property
    def held_points(self) -> np.ndarray:
        """(R, 3) places on the faces where holds grip [m]."""
        return self.grid.held_points

    @property
    def transfer(self) -> str:
        """Name of the transfer that simulates it."""
        return "mls"

    def nearest_free(self, points: np.ndarray) -> np.ndarray:
        """(K,) free particle nearest to each point (K, 3) [m]."""
        return cKDTree(self.geometry["points"][: LANES * self.free_block_count]).query(points)[1]


def discretise_particles(capture: Capture, boxes: np.ndarray, spacing: float) -> ParticleBody:
    """Fill a capture's parts with particles, eight to a cell and part, for given hold boxes.

    boxes: (H, 2, 3) [m]; spacing: of the grid [m]. Raises ValueError as `discretise` does.
    """
    grid = discretise(capture, boxes, spacing, fitting=False)
    free = grid.quadrature
    layers = [_clamp(capture, boxes, h, grid) for h in range(len(boxes))]
    together = {
        name: np.concatenate([getattr(q, name) for q in (free, *layers)])
        for name in ("cell", "part", "points", "volumes")
    }
    quadrature = replace(free, **together)
    hold = np.concatenate([np.full(len(q.part), h - 1) for h, q in enumerate((free, *layers))])
    points = quadrature.points.reshape(-1, 3)
    geometry = {
        "origin": quadrature.origin,
        "spacing": float(spacing),
        "points": points,
        "part": np.repeat(quadrature.part, LANES).astype(np.int32),
        "hold": np.repeat(hold, LANES).astype(np.int32),
        "hold_count": len(boxes),
        "hold_centre": boxes.mean(axis=1),
        "part_count": len(capture.parts),
    }
    body = ParticleBody(
        quadrature, geometry, boxes, grid.part_names, grid.centroid, capture.parts, grid=grid
    )
    excluded = boxes if len(boxes) else None
    samples = exposed_surface(capture.parts, max_edge=spacing / 2, exclude_boxes=excluded)
    if len(samples.area):
        nearest = body.nearest_free(samples.points)
        geometry["surface_area"] = np.bincount(nearest, samples.area, minlength=len(points))
    return body


def _clamp(capture: Capture, boxes: np.ndarray, number: int, grid: Body) -> Quadrature:
    """Blocks that one hold carries: a rigid backing, REACH cells deep, behind the faces where it grips.

    What a hold really encloses may be a thin slice, too light to lead the nodes that it shares with free
    material. Where the backing would stand in free material (on a thin grip inside the object) the slice
    itself has to do.
    """
    faces = hold_face(
        capture.parts, boxes[number], spacing=float(grid.quadrature.spacing[0]),
        other_boxes=np.delete(boxes, number, axis=0),
    )  # fmt: skip
    found = [_backing(face, boxes[number], grid) for face in faces]
    points, volumes = (np.concatenate(x) for x in zip(*found, strict=True))
    blocked = np.zeros(points.shape[:2], bool)
    for part in capture.parts:
        blocked |= inside(part, points.reshape(-1, 3)).reshape(blocked.shape)
    for box in boxes:
        blocked &= ~((points > box[0]) & (points < box[1])).all(2)
    points, volumes = points[~blocked.any(1)], volumes[~blocked.any(1)]
    if not len(points):
        return _slice(capture, boxes, number, grid.quadrature)
    free = grid.quadrature
    nearest = cKDTree(free.points.reshape(-1, 3)).query(points.mean(1))[1]
    cell = np.rint((points.mean(1) - free.origin) / free.spacing).astype(np.int32)
    return replace(free, cell=cell, part=free.part[nearest // LANES], points=points, volumes=volumes)


def _backing(face: HoldFace, box: np.ndarray, grid: Body) -> tuple[np.ndarray, np.ndarray]:
    """Points (B, 8, 3) [m] and volumes (B, 8) [m^3] behind one face, a block to a cell of it and a depth."""
    origin, spacing = grid.quadrature.origin, grid.quadrature.spacing
    across = [a for a in range(3) if a != face.axis]
    depth = spacing[face.axis]
    inward = depth if face.coordinate < box[:, face.axis].mean() else -depth
    tile = np.rint((face.points[:, across] - origin[across]) / spacing[across]).astype(int)
    _, block = np.unique(tile, axis=0, return_inverse=True)
    block = block.ravel()
    points, volumes = [], []
    for b in range(block.max() + 1):
        mine, area = face.points[block == b][:, across], face.area[block == b]
        mean = np.average(mine, axis=0, weights=area)
        spread = np.sqrt(np.average((mine - mean) ** 2, axis=0, weights=area) + area.mean() / 12.0)
        for layer in range(REACH):
            corner = np.empty((LANES, 3))
            signs = np.array(list(product((-1.0, 1.0), repeat=3)))
            corner[:, across] = mean + signs[:, :2] * spread
            corner[:, face.axis] = face.coordinate + inward * (layer + 0.5 + _GAUSS * signs[:, 2])
            points.append(corner)
            volumes.append(np.full(LANES, area.sum() * depth / LANES))
    return np.array(points), np.array(volumes)


def _slice(capture: Capture, boxes: np.ndarray, number: int, free: Quadrature) -> Quadrature:
    """The material that a hold encloses, of that which no other one does first."""
    low = np.min([part.vertices.min(0) for part in capture.parts], axis=0)
    shift = np.round((free.origin + 0.5 * free.spacing - low) / free.spacing, 9) % 1.0
    held = enclosed(capture.parts, boxes, number, float(free.spacing[0]), shift)
    cell = np.rint((held.points.mean(1) - free.origin) / free.spacing).astype(np.int32)
    return replace(held, cell=cell)
