"""Middle surfaces of sheets, given a thickness: closed meshes about them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from mphygs.capture.errors import fault
from mphygs.capture.triangles import directed_edges, loaded, merge, numbered


def read_sheet(path: Path, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of the closed mesh of a sheet about the middle surface in a file.

    thickness: [file unit]. Raises CaptureError where the file cannot be read, or is no surface with a rim and
    two sides.
    """
    expected = "a triangle mesh of a middle surface: open, with two sides, no edge in more than two triangles"
    vertices, faces = merge(*loaded(path, expected))
    edges = directed_edges(faces)
    count = np.unique(numbered(np.sort(edges, axis=1)), return_counts=True)[1]
    if count.max() > 2:
        raise fault(str(path), "an edge belongs to more than two triangles", expected)
    if count.min() == 2:
        raise fault(str(path), "is closed, and has no middle surface to give a thickness", expected)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    trimesh.repair.fix_winding(mesh)
    faces = np.array(mesh.faces, dtype=np.int64)
    edges = directed_edges(faces)
    there = numbered(edges)
    if len(np.unique(there)) < len(there):
        raise fault(str(path), "has one side only, like a Moebius strip", expected)
    corners = vertices[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = np.zeros_like(vertices)
    np.add.at(normal, faces.ravel(), np.repeat(cross, 3, axis=0))
    length = np.linalg.norm(normal, axis=1)
    if not (length > 0.0).all():
        raise fault(f"{path}: vertex {int(np.argmin(length))}", "has no normal", expected)
    step = 0.5 * thickness * normal / length[:, None]
    rim = edges[~np.isin(there, numbered(edges[:, ::-1]))]
    a, b, below = rim[:, 0], rim[:, 1], len(vertices)
    side = np.concatenate([np.stack([b, a, a + below], 1), np.stack([b, a + below, b + below], 1)])
    closed = np.concatenate([faces, faces[:, ::-1] + below, side])
    return np.concatenate([vertices + step, vertices - step]), closed
