"""Planes that a body may have met: outermost where it went, and the misfit pushes off them.

A wall is never passed, so its offset is the least that the body ever reached along its normal, give or take
what the feedback leaves; what is left to scan is the normal. No simulation is run here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

# Normals, spread evenly; cosine from which two are the same plane; planes that are returned.
DIRECTIONS, APART, COUNT = 600, 0.94, 10
# Of the body's size: how deep a surface point may stand behind a wall that it leans on.
SKINS = (0.01, 0.03)
# Markers whose misfit tells that of a surface point.
NEAREST = 4


@dataclass(frozen=True)
class Plane:
    """normal . x >= offset. normal: (3,) unit; offset: [m]; gain: how much of the misfit points out of it
    where the body touches it, of all misfit."""

    normal: tuple[float, float, float]
    offset: float
    gain: float

    @property
    def label(self) -> str:
        """The plane in words, n and d [m]."""
        return "plane n = ({:.2f}, {:.2f}, {:.2f}), d = {:.4f} m".format(*self.normal, self.offset)


def sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread evenly (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + 5.0**0.5) * k
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def touched_planes(
    surface: np.ndarray,
    rest: np.ndarray,
    residual: np.ndarray,
    markers: np.ndarray,
    *,
    count: int = COUNT,
) -> list[Plane]:
    """Planes that the misfit pushes off, the best first.

    surface: (T, S, 3) surface points on their way [m]; rest: (S, 3) at rest; residual: (T, M, 3) measured -
    predicted [m], NaN where not seen; markers: (M, 3) at rest.
    """
    near = cKDTree(markers).query(rest, k=min(NEAREST, len(markers)))[1].reshape(len(rest), -1)
    known = np.nan_to_num(residual)
    push = known[:, near].mean(2)  # (T, S, 3)
    total = float((push**2).sum())
    if total == 0.0:
        return []
    size = float(np.ptp(surface.reshape(-1, 3), axis=0).max())
    found: list[Plane] = []
    for normal in sphere(DIRECTIONS):
        height = surface @ normal
        outward = push @ normal
        low = float(height.min())
        for skin in SKINS:
            depth = np.maximum(low + skin * size - height, 0.0)
            touching = depth > 0.0
            weight = float((depth**2).sum())
            if not touching.any() or weight == 0.0:
                continue
            # What a push in proportion to the depth explains, at the amount that fits best.
            along = float((depth * outward).sum())
            if along > 0.0:
                plane = Plane(tuple(map(float, normal)), low + 0.5 * skin * size, along**2 / weight / total)
                found.append(plane)
    found.sort(key=lambda plane: -plane.gain)
    chosen: list[Plane] = []
    for plane in found:
        if all(np.dot(plane.normal, other.normal) < APART for other in chosen):
            chosen.append(plane)
        if len(chosen) == count:
            break
    return chosen
