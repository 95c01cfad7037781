"""A z-buffer for triangle meshes, of its own: it shares nothing with the renderer of Gaussians."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.capture.cameras import Camera

# Places in the boxes of triangles that are looked at together.
_AT_ONCE = 3_000_000


@dataclass(frozen=True, eq=False)
class Hits:
    """What is seen, one row for each sample of the picture that shows a triangle.

    sample: (N,) index into the (H s, W s) samples, row by row; face: (N,); weight: (N, 3) shares of the
    corners, perspective undone; depth: (N,) [m]; size: (H s, W s).
    """

    sample: np.ndarray
    face: np.ndarray
    weight: np.ndarray
    depth: np.ndarray
    size: tuple[int, int]

    def of_corners(self, values: np.ndarray, faces: np.ndarray) -> np.ndarray:
        """Values (N, ...) at the hits, of values (V, ...) at the vertices and faces (F, 3)."""
        return np.einsum("nk,nk...->n...", self.weight, values[faces[self.face]])

    def depth_picture(self) -> np.ndarray:
        """Depth (H s, W s) [m] of every sample, infinite where nothing is seen."""
        picture = np.full(self.size[0] * self.size[1], np.inf)
        picture[self.sample] = self.depth
        return picture.reshape(self.size)


def hits(camera: Camera, vertices: np.ndarray, faces: np.ndarray, *, samples: int) -> Hits:
    """The nearest triangle at every sample, `samples` of them along each side of a pixel.

    camera: without distortion; vertices: (V, 3) [m]; faces: (F, 3), outward: those seen from behind are left
    out. Raises ValueError for a surface that is not wholly in front of the camera.
    """
    fine = camera.resized(camera.width * samples, camera.height * samples)
    pixel, depth = fine.project(vertices)
    if not (depth > 0).all():
        raise ValueError(f'camera "{camera.name}": the surface reaches behind it; expected it in front')
    corner = pixel[faces]
    edge = corner[:, 1:] - corner[:, :1]
    twice = edge[:, 0, 0] * edge[:, 1, 1] - edge[:, 0, 1] * edge[:, 1, 0]
    # Counter-clockwise seen from outside is clockwise in a picture whose rows go down: below zero.
    low = np.maximum(np.ceil(corner.min(axis=1) - 0.5), 0).astype(np.int64)
    high = np.minimum(np.floor(corner.max(axis=1) - 0.5), [fine.width - 1, fine.height - 1]).astype(np.int64)
    extent = high - low + 1
    shown = np.flatnonzero((twice < -1e-9) & (extent > 0).all(axis=1))
    number = extent[shown].prod(axis=1)
    nearest = np.zeros(fine.width * fine.height)
    owner = np.full(len(nearest), -1)
    found = np.zeros((len(nearest), 2))
    begin = 0
    while begin < len(shown):
        total = np.cumsum(number[begin:])
        end = begin + max(1, int(np.searchsorted(total, _AT_ONCE, side="right")))
        some = shown[begin:end]
        row = np.repeat(np.arange(len(some)), number[begin:end])
        first = np.concatenate([[0], np.cumsum(number[begin:end])[:-1]])
        step = np.arange(len(row)) - first[row]
        face, width = some[row], extent[some, 0][row]
        u, v = low[face, 0] + step % width, low[face, 1] + step // width
        x, y = u + 0.5 - corner[face, 0, 0], v + 0.5 - corner[face, 0, 1]
        second = (x * edge[face, 1, 1] - y * edge[face, 1, 0]) / twice[face]
        third = (y * edge[face, 0, 0] - x * edge[face, 0, 1]) / twice[face]
        inside = np.flatnonzero((second >= 0) & (third >= 0) & (second + third <= 1))
        face, second, third = face[inside], second[inside], third[inside]
        sample = v[inside] * fine.width + u[inside]
        inverse = 1.0 / depth[faces[face]]
        near = inverse[:, 0] * (1 - second - third) + inverse[:, 1] * second + inverse[:, 2] * third
        np.maximum.at(nearest, sample, near)
        front = np.flatnonzero(near == nearest[sample])
        owner[sample[front]] = face[front]
        found[sample[front], 0], found[sample[front], 1] = second[front], third[front]
        begin = end
    sample = np.flatnonzero(owner >= 0)
    face = owner[sample]
    flat = np.column_stack([1.0 - found[sample].sum(axis=1), found[sample]])
    distance = 1.0 / nearest[sample]
    weight = flat / depth[faces[face]] * distance[:, None]
    return Hits(sample, face, weight, distance, (fine.height, fine.width))


def averaged(values: np.ndarray, surface_hits: Hits, samples: int) -> np.ndarray:
    """Pictures (H, W, C) of values (N, C) at the hits, 0 elsewhere, by the mean over each pixel's samples."""
    rows, columns = surface_hits.size
    # By counting, channel by channel: the means of a few thousand pixels out of many.
    row, column = np.divmod(surface_hits.sample, columns)
    pixel = (row // samples) * (columns // samples) + column // samples
    count = (rows // samples) * (columns // samples)
    sums = [np.bincount(pixel, weights=values[:, c], minlength=count) for c in range(values.shape[1])]
    return np.stack(sums, axis=1).reshape(rows // samples, columns // samples, -1) / samples**2


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3), means over the faces by their area."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    own = np.cross(b - a, c - a)
    normal = np.stack(
        [
            np.bincount(faces.ravel(), weights=np.repeat(own[:, k], 3), minlength=len(vertices))
            for k in range(3)
        ],
        axis=1,
    )
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
