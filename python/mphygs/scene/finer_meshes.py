"""Meshes divided until their edges are short."""

from __future__ import annotations

import numpy as np
import trimesh

# Where a mesh has more faces than this it stays as it is.
_MOST_FACES = 400_000


def finer(vertices: np.ndarray, faces: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Every triangle into four, all alike so that a closed mesh stays one, until no edge is longer [m].

    vertices: (V, 3) [m]; faces: (F, 3).
    """
    while len(faces) * 4 <= _MOST_FACES:
        corners = vertices[faces]
        if np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() <= longest:
            break
        vertices, faces = trimesh.remesh.subdivide(vertices, faces)
    return np.asarray(vertices), np.asarray(faces)
