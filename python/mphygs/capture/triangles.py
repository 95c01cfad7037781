"""Triangles as a mesh file has them, welded, and their edges."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import trimesh

from mphygs.capture.errors import fault
from mphygs.capture.mesh_files import mesh_content


def loaded(path: Path, expected: str) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces as they are in a file, all that faces name being there."""
    if not path.suffix:
        raise fault(str(path), "has no file ending", expected)
    content = mesh_content(path, expected)
    try:
        # from memory, so that no reader follows names in the file to other files
        content = io.BytesIO(content)
        mesh = trimesh.load_mesh(content, file_type=path.suffix[1:].lower(), process=False)
        vertices = np.array(mesh.vertices, dtype=np.float64)
        faces = np.array(mesh.faces, dtype=np.int64)
    except Exception as error:  # the readers raise whatever a damaged file trips them with
        reason = str(error) or type(error).__name__
        raise fault(str(path), f"cannot be read as a mesh, or is truncated ({reason})", expected) from error
    if vertices.ndim != 2 or vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or len(faces) == 0:
        raise fault(str(path), "has no triangles", expected)
    if not np.isfinite(vertices).all():
        raise fault(
            f"{path}: vertex {int(np.argwhere(~np.isfinite(vertices))[0, 0])}", "is not finite", expected
        )
    if faces.min() < 0 or faces.max() >= len(vertices):
        worst = faces.min() if faces.min() < 0 else faces.max()
        raise fault(str(path), f"a face names vertex {worst} of {len(vertices)}, counted from 0", expected)
    return compact(vertices, faces)


def compact(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Without vertices that no face names and faces that name a vertex twice; the order is kept."""
    corners = np.sort(faces, axis=1)
    faces = faces[(corners[:, 0] != corners[:, 1]) & (corners[:, 1] != corners[:, 2])]
    used, index = np.unique(faces, return_inverse=True)
    return vertices[used], index.reshape(-1, 3)


def merge(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mesh with vertices merged that lie within 1e-6 of its size of one another."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    digits = 6 - int(np.floor(np.log10(max(float(mesh.scale), 1e-300))))
    mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=digits)
    return compact(np.array(mesh.vertices), np.array(mesh.faces, dtype=np.int64))


def directed_edges(faces: np.ndarray) -> np.ndarray:
    return faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)


def numbered(edges: np.ndarray) -> np.ndarray:
    """One number for each pair of (N, 2) numbers from 0 to below 2^31, the same for the same pair; (N,)."""
    return edges[:, 0] << 31 | edges[:, 1]
