"""An object as particles for the MLS-MPM transfer: its free material, and what of the held one borders it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from mphygs.capture.format import Capture
from mphygs.scene.particles import Quadrature, exposed_surface, fill
from mphygs.scene.slivers import merge_slivers
from mphygs.simulate.body import LANES, SMALLEST_SHARE, Body, discretise

# Cells between held and free material that share a node of the quadratic splines.
REACH = 2


@dataclass(frozen=True, eq=False)
class ParticleBody(Body):
    """Particles are the quadrature's points, block after block: those of the free material first, the same
    as the total-Lagrangian transfer's on `grid`, then those that the holds carry."""

    grid: Body = field(repr=False, kw_only=True)

    @property
    def free_block_count(self) -> int:
        return self.grid.block_count

    @property
    def held_points(self) -> np.ndarray:
        return self.grid.held_points

    @property
    def transfer(self) -> str:
        return "mls"

    def nearest_free(self, points: np.ndarray) -> np.ndarray:
        """(K,) free particle nearest to each point (K, 3) [m]."""
        return cKDTree(self.geometry["points"][: LANES * self.free_block_count]).query(points)[1]


def discretise_particles(capture: Capture, boxes: np.ndarray, spacing: float) -> ParticleBody:
    """Fill a capture's parts with particles, eight to a cell and part, for given hold boxes.

    boxes: (H, 2, 3) [m]; spacing: of the grid [m]. Raises ValueError as `discretise` does.
    """
    grid = discretise(capture, boxes, spacing)
    free = grid.quadrature
    layers = [_held_layer(capture, boxes[: h + 1], free) for h in range(len(boxes))]
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


def _held_layer(capture: Capture, boxes: np.ndarray, free: Quadrature) -> Quadrature:
    """The material in the last of some hold boxes, and in none before it, as far as its cells share nodes
    with free material."""
    vertices = np.concatenate([part.vertices for part in capture.parts])
    low, high = vertices.min(0), vertices.max(0)
    spacing = free.spacing
    shift = np.round((free.origin + 0.5 * spacing - low) / spacing, 9) % 1.0
    held = fill(
        capture.parts,
        spacing=float(spacing[0]),
        exclude_boxes=np.concatenate([_outside(boxes[-1], low, high), boxes[:-1]]),
        origin_offset=shift,
    )
    held = merge_slivers(held, share=SMALLEST_SHARE)
    cell = np.rint((held.points.mean(1) - free.origin) / spacing).astype(np.int32)
    apart = cKDTree(np.unique(free.cell, axis=0)).query(cell, p=np.inf)[0]
    kept = apart <= REACH + 1e-9
    return replace(
        held, cell=cell[kept], part=held.part[kept], points=held.points[kept], volumes=held.volumes[kept]
    )


def _outside(box: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(K, 2, 3) boxes that cover all of [low, high] but a box (2, 3)."""
    size = high - low
    around = np.array([low - size - 1.0, high + size + 1.0])
    slabs = []
    for axis in range(3):
        if box[0, axis] > around[0, axis]:
            slabs.append(around.copy())
            slabs[-1][1, axis] = box[0, axis]
        if box[1, axis] < around[1, axis]:
            slabs.append(around.copy())
            slabs[-1][0, axis] = box[1, axis]
    return np.array(slabs).reshape(-1, 2, 3)
