"""The solid behind surfaces that cameras see: inside is what no camera looks through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import label

from mphygs.capture.cameras import Camera
from mphygs.scene.lattice import Lattice

# Views that must see a place as empty before it is: single ones are wrong at edges and in noise of depth.
_WITNESSES = 3
# In front of the nearest surface within a pixel by so many pixels' widths, one view is enough.
_SURE = 4.0
_CHUNK = 400_000  # points looked at together


@dataclass(frozen=True, eq=False)
class SeenDepth:
    """One view of the object. depth: (H, W), of the nearest surface [m], infinite where there is none;
    outside: (H, W), distance to the silhouette [px], negative inside it."""

    camera: Camera
    depth: np.ndarray
    outside: np.ndarray


def silhouette_distance(mask: np.ndarray) -> np.ndarray:
    """Distance (H, W) [px] of pixel centres from the edge of a mask (H, W), negative inside.

    The edge is where the mask passes 1/2, found between pixels from the mask's own grey.
    """
    solid = (mask >= 0.5).astype(np.uint8)
    away = cv2.distanceTransform(1 - solid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    within = cv2.distanceTransform(solid, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    distance = np.where(solid > 0, 0.5 - within, away - 0.5)
    # next to the edge the share of the pixel that is covered says more
    grey = (mask > 0.02) & (mask < 0.98) & (np.abs(distance) <= 1.0)
    return np.where(grey, 0.5 - mask, distance).astype(np.float32)


def signed_distance(views: Sequence[SeenDepth], points: np.ndarray) -> np.ndarray:
    """Distance (N,) [m] of points (N, 3) [m] from the surface that views see, negative inside.

    Outside are points that three views see beside the silhouette or in front of the surface, or one view far
    in front of all that is near in its picture. Their distance is the largest to a silhouette, which is none
    too large; where there is none the least that a view gives to the surface behind them, as the view that
    looks at it straight gives it. That of a point inside is the least depth that a view gives. Points that no
    view has in its picture are outside.
    """
    result = np.empty(len(points))
    for first in range(0, len(points), _CHUNK):
        chunk = points[first : first + _CHUNK]
        result[first : first + _CHUNK] = _signed_distance(views, chunk)
    return result


def _signed_distance(views: Sequence[SeenDepth], points: np.ndarray) -> np.ndarray:
    beside = np.zeros(len(points))  # largest of the distances to silhouettes
    before = np.full(len(points), np.inf)  # least of those to a surface behind
    deep = np.full(len(points), -np.inf)  # least depth
    witnesses = np.zeros(len(points), dtype=np.int64)
    for view in views:
        camera = view.camera
        pixels, depth = camera.project(points)
        within = (depth > 0) & (pixels >= 0.5).all(axis=1)
        within &= (pixels < [camera.width - 0.5, camera.height - 0.5]).all(axis=1)
        index = np.flatnonzero(within)
        edge = _between(view.outside, pixels[index]) * depth[index] / camera.focal.mean()
        column, row = pixels[index].astype(int).T
        # within the silhouette, but no surface drawn: the view says nothing of depth
        surface = view.depth[row, column]
        gap = np.where(np.isfinite(surface), surface - depth[index], -np.inf)
        out = edge >= 0
        beside[index[out]] = np.maximum(beside[index[out]], edge[out])
        front = ~out & (gap > 0)
        before[index[front]] = np.minimum(before[index[front]], gap[front])
        witnesses[index[out | front]] += 1
        clear = cv2.erode(view.depth, np.ones((3, 3), np.uint8))[row, column] - depth[index]
        sure = np.isfinite(clear) & (clear > _SURE * depth[index] / camera.focal.mean())
        witnesses[index[~out & sure]] += _WITNESSES
        behind = ~(out | front)
        deep[index[behind]] = np.maximum(deep[index[behind]], np.maximum(gap, edge)[behind])
    outside = (witnesses >= _WITNESSES) | ~np.isfinite(deep)
    distance = np.where(beside > 0, beside, np.where(np.isfinite(before), before, 1.0))
    return np.where(outside, distance, np.minimum(deep, 0.0))


def _between(values: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Pixel values (H, W) at pixels (N, 2), whose centres are at halves, by bilinear interpolation."""
    place = pixels.astype(np.float32) - np.float32(0.5)
    out = np.empty(len(place), dtype=np.float32)
    step = 30_000  # cv2.remap takes no side of more than 32767
    for first in range(0, len(place), step):
        part = place[first : first + step]
        out[first : first + step] = cv2.remap(
            values, part[:, :1], part[:, 1:], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )[:, 0]
    return out


def largest_body(inside: np.ndarray, *, least_share: float = 0.02) -> np.ndarray:
    """Voxels (X, Y, Z) without bodies that are smaller than `least_share` of the largest; neighbours share a
    face, an edge or a corner."""
    labels, count = label(inside, structure=np.ones((3, 3, 3)))
    if count <= 1:
        return inside
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return inside & np.isin(labels, np.flatnonzero(sizes >= least_share * sizes.max()))


def refined(lattice: Lattice, distance: np.ndarray, views: Sequence[SeenDepth]) -> tuple[Lattice, np.ndarray]:
    """A lattice of half the spacing, computed anew only near the surface: distances (X, Y, Z) [m]."""
    fine = Lattice(
        lattice.corner - 0.25 * lattice.spacing, 0.5 * lattice.spacing, tuple(2 * n for n in lattice.shape)
    )
    values = distance
    for axis in range(3):
        values = np.repeat(values, 2, axis=axis)
    values = values.copy()
    near = np.flatnonzero(np.abs(values.ravel()) < 3.0 * lattice.spacing)
    values.ravel()[near] = signed_distance(views, fine.points(near))
    return fine, values


def edge_gap(lattice: Lattice, distance: np.ndarray, views: Sequence[SeenDepth], *, most: int = 400) -> float:
    """How far [m] the solid stays behind the silhouettes, in the median over lines of sight along edges.

    A line through the edge of a silhouette touches the object: the least distance (X, Y, Z) on it should be
    0. most: lines of each view.
    """
    corners = lattice.points(np.array([0, lattice.count - 1]))
    middle, radius = corners.mean(axis=0), 0.5 * float(np.linalg.norm(corners[1] - corners[0]))
    along = np.arange(-radius, radius, 0.7 * lattice.spacing)
    found = []
    for view in views:
        row, column = np.nonzero(np.abs(view.outside) < 0.75)
        chosen = np.linspace(0, len(row) - 1, min(most, len(row))).astype(int)
        pixels = np.stack([column, row], axis=1)[chosen] + 0.5
        # by how much the pixel's centre lies beside the edge
        beside = view.outside[row, column][chosen]
        rays = view.camera.rays(pixels)
        start = (middle - view.camera.position) @ rays.T
        places = view.camera.position + rays[:, None] * (start[:, None] + along)[..., None]
        least = lattice.at(distance, places.reshape(-1, 3)).reshape(len(rays), -1).min(axis=1)
        scale = view.camera.project(middle[None])[1][0] / view.camera.focal.mean()
        found.append(least - beside * scale)
    return float(np.median(np.concatenate(found)))


def solid_behind(
    views: Sequence[SeenDepth], points: np.ndarray, *, spacing: float, rounds: int = 3
) -> tuple[Lattice, np.ndarray, float]:
    """The solid that views of depth and silhouettes leave about points (N, 3) [m].

    Depths that splatting gives lie below the surface, by about the size of a Gaussian: they are lifted by one
    length until the solid fills the silhouettes. Returns a lattice of `spacing` [m], distances (X, Y, Z) [m],
    negative inside, and that length [m].
    """
    coarse = Lattice.about(points, spacing=2.0 * spacing, margin=8.0 * spacing)
    places = coarse.points()
    lift = 0.0
    for _ in range(rounds):
        distance = signed_distance(_lifted(views, lift), places).reshape(coarse.shape)
        lift = max(lift + edge_gap(coarse, distance, views), 0.0)
    lifted = _lifted(views, lift)
    lattice, distance = refined(coarse, signed_distance(lifted, places).reshape(coarse.shape), lifted)
    specks = (distance <= 0) & ~largest_body(distance <= 0)
    return lattice, np.where(specks, 0.5 * spacing, distance), lift


def _lifted(views: Sequence[SeenDepth], lift: float) -> list[SeenDepth]:
    return [SeenDepth(v.camera, v.depth - np.float32(lift), v.outside) for v in views]
