"""The round parts of a flower: a bent stem of rings, and the receptacle that sits on its last ring."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.synth.flower.blade import Root
from mphygs.synth.flower.textured_surface import Surface, annulus, between_rings, cap


@dataclass(frozen=True, eq=False)
class Rings:
    """Rings of vertices about a line.

    points: (S, K, 3) [m]; centre: (S, 3) [m]; up, side, across: (S, 3) unit vectors of each ring's frame;
    vertex k stands at the angle 2 pi k / K from `side` towards `across`.
    """

    points: np.ndarray
    centre: np.ndarray
    up: np.ndarray
    side: np.ndarray
    across: np.ndarray

    def root(self, ring: int, first: int, columns: int, *, wedge: float | None, gap: float) -> Root:
        """The patch from ring to ring + 1 of `columns` columns from vertex `first` on."""
        count = self.points.shape[1]
        rows = np.arange(first, first + columns + 1) % count
        angle = 2.0 * np.pi * (first + 0.5 * columns) / count
        out = np.cos(angle) * self.side[ring] + np.sin(angle) * self.across[ring]
        along = -np.sin(angle) * self.side[ring] + np.cos(angle) * self.across[ring]
        return Root(
            lower=self.points[ring, rows],
            upper=self.points[ring + 1, rows],
            out=out,
            side=along,
            up=self.up[ring],
            centre=self.centre[ring],
            wedge=wedge,
            gap=gap,
        )


def bent_rings(
    *, height: float, radius: float, top_radius: float, lean: float, count: int, step: float
) -> Rings:
    """Rings of a stem from z = 0 on, bending in x by `lean` [degree] in all, most of it near the top.

    height: length of its line [m]; radius, top_radius: [m]; count: vertices of a ring; step: between rings
    at most [m].
    """
    steps = int(np.ceil(height / step))
    share = np.linspace(0.0, 1.0, steps + 1)
    tilt = np.radians(lean) * share**3
    middle = 0.5 * (tilt[1:] + tilt[:-1])
    centre = np.zeros((steps + 1, 3))
    centre[1:, 0] = np.cumsum(np.sin(middle)) * height / steps
    centre[1:, 2] = np.cumsum(np.cos(middle)) * height / steps
    zero = np.zeros_like(tilt)
    up = np.stack([np.sin(tilt), zero, np.cos(tilt)], axis=1)
    side = np.stack([np.cos(tilt), zero, -np.sin(tilt)], axis=1)
    across = np.broadcast_to([0.0, 1.0, 0.0], up.shape)
    size = radius + (top_radius - radius) * share
    return Rings(_ring_points(centre, side, across, size, count), centre, up, side, across)


def stem_surface(rings: Rings) -> Surface:
    """The closed stem: its side, its foot, and the disc that the receptacle sits on."""
    steps, count = rings.points.shape[:2]
    vertices = np.concatenate([rings.points.reshape(-1, 3), rings.centre[[0, -1]]])
    index = np.arange(steps * count).reshape(steps, count)
    faces = [between_rings(a, b) for a, b in zip(index[:-1], index[1:], strict=True)]
    faces += [cap(index[0], steps * count)[:, ::-1], cap(index[-1], steps * count + 1)]
    along = np.concatenate([np.repeat(np.linspace(0.0, 1.0, steps), count), [0.0, 1.0]])
    return Surface(vertices, np.concatenate(faces), along, _angles(steps, count, 2), np.zeros(len(vertices)))


def receptacle_rings(stem: Rings, profile: np.ndarray, count: int) -> Rings:
    """Rings above the end of a stem. profile: (S, 2) radius, height of each [m]; count: vertices of each."""
    up, side, across = (np.repeat(v[-1:], len(profile), axis=0) for v in (stem.up, stem.side, stem.across))
    centre = stem.centre[-1] + profile[:, 1:] * up
    return Rings(_ring_points(centre, side, across, profile[:, 0], count), centre, up, side, across)


def receptacle_surface(stem: Rings, rings: Rings, top: float) -> Surface:
    """The closed receptacle; its foot has the very triangles of the stem's end. top: height of its tip."""
    steps, count = rings.points.shape[:2]
    foot = stem.points[-1]
    tip = stem.centre[-1] + top * rings.up[-1]
    vertices = np.concatenate([rings.points.reshape(-1, 3), foot, [stem.centre[-1], tip]])
    index = np.arange(steps * count).reshape(steps, count)
    ring = steps * count + np.arange(len(foot))
    faces = [between_rings(a, b) for a, b in zip(index[:-1], index[1:], strict=True)]
    faces += [cap(ring, len(vertices) - 2)[:, ::-1], annulus(ring, index[0])[:, ::-1]]
    faces.append(cap(index[-1], len(vertices) - 1))
    along = np.concatenate([np.repeat(np.linspace(0.0, 1.0, steps), count), np.zeros(len(foot) + 1), [1.0]])
    across = np.concatenate([_angles(steps, count, 0), _angles(1, len(foot), 2)])
    return Surface(vertices, np.concatenate(faces), along, across, np.zeros(len(vertices)))


def _ring_points(
    centre: np.ndarray, side: np.ndarray, across: np.ndarray, radius: np.ndarray, count: int
) -> np.ndarray:
    angle = 2.0 * np.pi * np.arange(count) / count
    around = np.cos(angle)[None, :, None] * side[:, None] + np.sin(angle)[None, :, None] * across[:, None]
    return centre[:, None] + np.asarray(radius)[:, None, None] * around


def _angles(steps: int, count: int, further: int) -> np.ndarray:
    """Angle over pi, -1 to 1, of all ring vertices and of `further` ones in the middle."""
    angle = np.tile(2.0 * np.arange(count) / count - 1.0, steps)
    return np.concatenate([angle, np.zeros(further)])
