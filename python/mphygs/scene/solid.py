"""The solid behind surfaces that cameras see: inside is what no camera looks through."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import distance_transform_edt, label

from mphygs.capture.cameras import Camera
from mphygs.scene.lattice import Lattice

# Views that must see a place as empty before it is: single ones are wrong at edges and in noise of depth.
# Few views leave few witnesses: of less than twelve, two or one are enough.
_WITNESSES, _VIEWS_A_WITNESS = 3, 4
# In front of the nearest surface within a pixel by so many pixels' widths, one view is enough.
_SURE = 4.0
_CHUNK = 400_000  # points looked at together
_STEPS = 64  # on a line of sight
_REACH = 0.125  # of the object's length, more than depths are ever wrong by
# Standard deviations of depth by which the third deepest of the about eight views of a place lies too deep.
_CARVED = 0.5


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

    Outside are points that three views (of fewer than twelve, a quarter) see beside the silhouette or in
    front of the surface, or one view far in front of all that is near in its picture. Their distance is the
    largest to a silhouette, which is none too large; where there is none the least that a view gives to the
    surface behind them, as the view that looks at it straight gives it. That of a point inside is the least
    depth that a view gives. Points that no view has in its picture are outside.
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
    needed = int(np.clip(len(views) // _VIEWS_A_WITNESS, 1, _WITNESSES))
    for view in views:
        pixels, depth, index = _within(view.camera, points)
        width = depth / view.camera.focal.mean()  # of a pixel [m]
        edge = _between(view.outside, pixels) * width
        column, row = pixels.astype(int).T
        # within the silhouette, but no surface drawn: the view says nothing of depth
        surface = view.depth[row, column]
        gap = np.where(np.isfinite(surface), surface - depth, -np.inf)
        out = edge >= 0
        beside[index[out]] = np.maximum(beside[index[out]], edge[out])
        front = ~out & (gap > 0)
        before[index[front]] = np.minimum(before[index[front]], gap[front])
        witnesses[index[out | front]] += 1
        clear = cv2.erode(view.depth, np.ones((3, 3), np.uint8))[row, column] - depth
        sure = np.isfinite(clear) & (clear > _SURE * width)
        witnesses[index[~out & sure]] += needed
        behind = ~(out | front)
        deep[index[behind]] = np.maximum(deep[index[behind]], np.maximum(gap, edge)[behind])
    outside = (witnesses >= needed) | ~np.isfinite(deep)
    distance = np.where(beside > 0, beside, np.where(np.isfinite(before), before, 1.0))
    return np.where(outside, distance, np.minimum(deep, 0.0))


def _within(camera: Camera, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixels (M, 2) and depths (M,) [m] of those of points (N, 3) [m] that the camera has in its picture, and
    their numbers (M,)."""
    pixels, depth = camera.project(points)
    within = (depth > 0) & (pixels >= 0.5).all(axis=1)
    within &= (pixels < [camera.width - 0.5, camera.height - 0.5]).all(axis=1)
    index = np.flatnonzero(within)
    return pixels[index], depth[index], index


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


def refined_near_surface(
    lattice: Lattice, distance: np.ndarray, views: Sequence[SeenDepth]
) -> tuple[Lattice, np.ndarray]:
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


def depth_error(views: Sequence[SeenDepth], *, reach: float, most: int = 150) -> float:
    """How far [m] depths lie behind the surface, from the room between them and the silhouettes.

    From a place at the depth that a view gives one can go towards its camera until a silhouette ends. The
    surface is not nearer than that, and a good part of it lies just there: the distances gather about the
    error that depths have, those of hollows are longer. Their most frequent value is taken, by the shortest
    interval with half of them (Rousseeuw 1984), and a share of their spread that carving by a few witnesses
    costs.

    reach: how far is looked [m], more than the error; most: lines of each view. 0 where nothing tells.
    """
    room = _room(views, reach, most)
    if len(room) == 0:
        return 0.0
    # once more, in finer steps
    room = np.sort(_room(views, min(reach, max(3.0 * float(np.median(room)), reach / _STEPS)), most))
    half = (len(room) + 1) // 2
    width = room[half - 1 :] - room[: len(room) - half + 1]
    first = int(width.argmin())
    # of a normal distribution the middle half is 1.35 standard deviations wide
    return float(np.median(room[first : first + half]) + _CARVED * width[first] / 1.349)


def _room(views: Sequence[SeenDepth], reach: float, most: int) -> np.ndarray:
    """Distances (M,) along depth [m], up to `reach`, from places on the surface to where silhouettes end."""
    found = []
    back = np.linspace(0.0, reach, _STEPS + 1)
    for view in views:
        row, column = np.nonzero((view.outside < -1.5) & np.isfinite(view.depth))
        chosen = np.linspace(0, len(row) - 1, min(most, len(row))).astype(int)
        row, column = row[chosen], column[chosen]
        rays = view.camera.rays(np.stack([column, row], axis=1) + 0.5)
        along = rays @ view.camera.camera_from_world[2, :3]
        distance = (view.depth[row, column][:, None] - back) / along[:, None]
        points = (view.camera.position + rays[:, None] * distance[..., None]).reshape(-1, 3)
        solid = np.ones(len(points), dtype=bool)
        for other in views:
            pixels, index = _within(other.camera, points)[::2]
            solid[index] &= _between(other.outside, pixels) < 0
        solid = solid.reshape(distance.shape)
        count = np.where(solid.all(axis=1), _STEPS, solid.argmin(axis=1))
        # places that are beside a silhouette themselves say nothing
        found.append(back[count[solid[:, 0]]])
    return np.concatenate(found)


def _bounded(distance: np.ndarray, inside: np.ndarray, spacing: float) -> np.ndarray:
    """Distances (X, Y, Z) [m] of which none is larger than that to the nearest voxel on the other side.

    Those that views give can be: what one looks past far in front of a surface, or into it along itself.
    Where they jump, a surface drawn between voxels would lie at one of them instead of half way.
    """
    if not inside.any() or inside.all():
        return distance
    out = distance_transform_edt(~inside, sampling=spacing)
    deep = distance_transform_edt(inside, sampling=spacing)
    return np.clip(distance, -deep, out)


def solid_behind(
    views: Sequence[SeenDepth], points: np.ndarray, *, spacing: float
) -> tuple[Lattice, np.ndarray, float]:
    """The solid that views of depth and silhouettes leave about points (N, 3) [m].

    Depths that splatting gives lie below the surface, as far as one sees into the Gaussians: they are lifted
    by one length, `depth_error`. Returns a lattice of `spacing` [m], distances (X, Y, Z) [m], negative
    inside, and that length [m].
    """
    coarse = Lattice.about(points, spacing=2.0 * spacing, margin=8.0 * spacing)
    lift = depth_error(views, reach=_REACH * float(np.linalg.norm(np.ptp(points, axis=0))))
    lifted = [SeenDepth(v.camera, v.depth - np.float32(lift), v.outside) for v in views]
    distance = signed_distance(lifted, coarse.points()).reshape(coarse.shape)
    lattice, distance = refined_near_surface(coarse, distance, lifted)
    inside = largest_body(distance <= 0)
    distance = np.where((distance <= 0) & ~inside, 0.5 * spacing, distance)
    return lattice, _bounded(distance, inside, spacing), lift
