"""What of the material a hold carries: it weighs on the hold, and the hold moves it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mphygs.capture.holds import Hold
from mphygs.capture.meshes import Part
from mphygs.model.belief import Belief
from mphygs.scene.particles import Quadrature, fill, fill_each
from mphygs.scene.slivers import merge_slivers
from mphygs.simulate.body import Body
from mphygs.simulate.discretisation import SMALLEST_SHARE
from mphygs.simulate.fields import gravity_of, point_fields

# Of a frame: step of the differences that give the acceleration of a hold.
_STEP = 0.01


@dataclass(frozen=True, eq=False)
class HeldMaterial:
    """The material in a hold's box, which its motion carries rigidly. body: with its points in place of the
    free ones; fps: of the hold's motion."""

    body: Body
    hold: Hold
    fps: float

    @classmethod
    def of(cls, body: Body, number: int, hold: Hold, fps: float) -> HeldMaterial:
        """Of the hold of a number, on whose box a body was built."""
        if body.curved:
            inside = enclosed_on(body, number)
        else:
            inside = enclosed(body.parts, body.boxes, number, float(np.min(body.quadrature.spacing)))
        return cls(replace(body, quadrature=inside), hold, fps)

    @property
    def centre(self) -> np.ndarray:
        """(3,) of the box, at rest [m]."""
        return np.asarray(self.hold.box, float).mean(axis=0)

    def wrench(self, belief: Belief, times: np.ndarray) -> np.ndarray:
        """(T, 2, 3) force [N] and torque about the box's centre [N m] that move the held material as the
        hold does, against its weight, at times (T,) [s]."""
        mass = (point_fields(belief, self.body).density * self.body.quadrature.volumes).ravel()
        points = self.body.quadrature.points.reshape(-1, 3)
        total = mass.sum()
        # Everything is linear in the first and second moments about the centre.
        arm = points - self.centre
        first, second = mass @ arm, np.einsum("q,qi,qj->ij", mass, arm, arm)
        step = _STEP / self.fps
        (r0, p0), (r, p), (r1, p1) = (self.hold.poses(times + d, self.fps) for d in (-step, 0.0, step))
        turning, moving = (r1 - 2.0 * r + r0) / step**2, (p1 - 2.0 * p + p0) / step**2
        centre = turning @ self.centre + moving - gravity_of(belief, self.body)
        force = total * centre + turning @ first
        # sum m (R a) x (R'' a + c), R a the arm as it is turned.
        crossed = r @ second @ np.swapaxes(turning, 1, 2)
        spin = np.stack([crossed[:, i, j] - crossed[:, j, i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)
        return np.stack([force, np.cross(r @ first, centre) + spin], axis=1)


def enclosed(
    parts: Sequence[Part],
    boxes: np.ndarray,
    number: int,
    spacing: float,
    shift: np.ndarray | tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Quadrature:
    """Points of the material that a hold encloses, of that which no earlier one does.

    boxes: (H, 2, 3) of all holds [m]; number: of the hold; spacing: of the points' cells [m];
    shift: of these, in cells.
    """
    vertices = np.concatenate([part.vertices for part in parts])
    around = outside(boxes[number], vertices.min(0), vertices.max(0))
    held = fill(
        parts,
        spacing=spacing,
        exclude_boxes=np.concatenate([around, boxes[:number]]),
        origin_offset=shift,
    )
    return merge_slivers(held, share=SMALLEST_SHARE)


def enclosed_on(body: Body, number: int) -> Quadrature:
    """The same on the grids that rods and shells have: columns of a lattice may miss what is thin."""
    vertices = np.concatenate([part.vertices for part in body.parts])
    around = outside(body.boxes[number], vertices.min(0), vertices.max(0))
    charts = body.quadrature.charts
    lattices = [s.min() for s, chart in zip(body.quadrature.spacings, charts, strict=True) if chart is None]
    return fill_each(
        body.parts,
        spacing=float(min(lattices, default=np.max(body.quadrature.spacings))),
        exclude_boxes=np.concatenate([around, body.boxes[:number]]),
        charts=charts,
    )


def outside(box: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
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
