"""Closed surfaces that carry coordinates for their texture, and rings of vertices joined to such surfaces."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Surface:
    """A closed surface, outward.

    vertices: (V, 3) [m]; faces: (F, 3); along: (V,), 0 at the root to 1 at the tip; across: (V,), -1 to 1
    from edge to edge of a blade, the angle over pi on what is round; number: (V,), of the blade or 0.
    """

    vertices: np.ndarray
    faces: np.ndarray
    along: np.ndarray
    across: np.ndarray
    number: np.ndarray


def joined_surfaces(surfaces: Sequence[Surface]) -> Surface:
    """Several surfaces as one, their vertices kept apart."""
    shift = np.cumsum([0, *(len(s.vertices) for s in surfaces[:-1])])
    faces = np.concatenate([s.faces + k for s, k in zip(surfaces, shift, strict=True)])
    rows = (np.concatenate(v) for v in zip(*((s.along, s.across, s.number) for s in surfaces), strict=True))
    return Surface(np.concatenate([s.vertices for s in surfaces]), faces, *rows)


def quads(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
    """(2 n, 3) triangles of quadrilaterals a b c d (n,), each cut from a to c."""
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def between_rings(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """Triangles between two rings of vertex indices (K,), counter-clockwise seen from above."""
    return quads(lower, np.roll(lower, -1), np.roll(upper, -1), upper)


def annulus(inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Triangles, counter-clockwise, between a ring (K,) and one of a multiple of its vertices (m K,)."""
    count, times = len(inner), len(outer) // len(inner)
    faces = []
    for k in range(count):
        for j in range(times):
            at = k * times + j
            own = inner[k] if j < (times + 1) // 2 else inner[(k + 1) % count]
            faces.append((own, outer[at], outer[(at + 1) % len(outer)]))
            if j == (times + 1) // 2 - 1:
                faces.append((inner[k], outer[(at + 1) % len(outer)], inner[(k + 1) % count]))
    return np.array(faces)


def cap(ring: np.ndarray, centre: int) -> np.ndarray:
    """A fan about a vertex, counter-clockwise as the ring (K,) is."""
    return np.stack([np.full(len(ring), centre), ring, np.roll(ring, -1)], axis=1)
