"""Whether the cameras of a motion fit each other, and whether what they show is the object of the rest views.

Done on pictures alone, before anything is fitted to them: a camera whose pose is wrong is found and named by
its reprojection error, a set of pictures of something else by its size and its colours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.capture.annotations import Correspondence
from mphygs.capture.cameras import Camera
from mphygs.capture.errors import fault
from mphygs.capture.views import Photograph
from mphygs.scene.hull import visual_hull

# Root of the mean square distance between a pixel pointed at and the point it belongs to, from which it is no
# longer the error of a hand [px], and in pictures of more pixels [px at a width of 1000].
_LARGEST_ERROR, _LARGEST_ERROR_OF_1000 = 2.5, 12.0
# Of the object's length in the motion's pictures over that in the rest views. Few cameras may not see all
# of its length.
_SIZES = (0.6, 1.5)
# Share of colours in common, of histograms of that many bins a channel.
_LEAST_COLOURS, _BINS = 0.2, 6
_HULL = 48  # voxels along the longest side
_DIRECTIONS = 36  # that a silhouette is measured in


@dataclass(frozen=True)
class Agreement:
    """What was compared.

    size: length in the motion's pictures over that at rest; colours: share of the colours in
    common, 0 to 1; error: camera -> its reprojection error [px], for cameras whose pictures were pointed in.
    """

    size: float
    colours: float
    error: dict[str, float]


def check_first_frame(
    rest: Sequence[Photograph],
    first: Sequence[Photograph],
    correspondences: Sequence[Correspondence] = (),
    *,
    where: str = "frame 0",
) -> Agreement:
    """Raise CaptureError unless the pictures of a motion's first frame fit each other and the rest views.

    rest: the rest views; first: frame 0 of every camera; where: how messages name the motion. The object may
    have been moved and turned between the two. Lengths are compared by the longest way
    across a silhouette, colours by the overlap of their histograms (Swain and Ballard 1991).
    """
    error = _checked_errors(
        {p.camera.name: p.camera for p in first}, [c.first for c in correspondences], where
    )
    size = _length(first) / _length(rest)
    if not _SIZES[0] <= size <= _SIZES[1]:
        raise fault(
            where,
            f"shows an object {size:.2f} times as large as the rest views",
            "the same object, and cameras of both in metres (scale beside views)",
        )
    colours = float(np.minimum(_histogram(rest), _histogram(first)).sum())
    if colours < _LEAST_COLOURS:
        raise fault(
            where,
            f"has {colours:.0%} of its colours in common with the rest views",
            "pictures of the same object",
        )
    return Agreement(size, colours, error)


def reprojection_errors(
    cameras: Mapping[str, Camera], points: Sequence[Mapping[str, np.ndarray]]
) -> dict[str, float]:
    """Camera -> root mean square distance [px] from its pixels to the points that all cameras fix together.

    points: of each, camera -> pixel (2,), undistorted; a point seen by fewer than two cameras fixes nothing.
    """
    squares: dict[str, list[float]] = {}
    for pixels in points:
        if len(pixels) < 2:
            continue
        place = triangulate([cameras[name] for name in pixels], np.array(list(pixels.values())))
        for name, pixel in pixels.items():
            seen = cameras[name].project(place[None])[0][0]
            distance = float(((seen - pixel) ** 2).sum()) if np.isfinite(seen).all() else np.inf
            squares.setdefault(name, []).append(distance)
    return {name: float(np.sqrt(np.mean(values))) for name, values in squares.items()}


def triangulate(cameras: Sequence[Camera], pixels: np.ndarray) -> np.ndarray:
    """The point (3,) [m] nearest to the lines of sight through pixels (V, 2), undistorted.

    Raises ValueError where they are parallel.
    """
    rays = np.array([camera.rays(pixel) for camera, pixel in zip(cameras, pixels, strict=True)])
    across = np.eye(3) - rays[:, :, None] * rays[:, None]
    positions = np.array([camera.position for camera in cameras])
    matrix = across.sum(axis=0)
    if np.linalg.eigvalsh(matrix)[0] < 1e-9:
        raise ValueError("the lines of sight are parallel; expected views from several sides")
    return np.linalg.solve(matrix, np.einsum("vij,vj->i", across, positions))


def _checked_errors(
    cameras: Mapping[str, Camera], points: Sequence[Mapping[str, np.ndarray]], where: str
) -> dict[str, float]:
    """Reprojection errors; CaptureError, with the camera without which the others agree, for large ones."""
    error = reprojection_errors(cameras, points)
    limit = {
        name: max(_LARGEST_ERROR, _LARGEST_ERROR_OF_1000 * cameras[name].width / 1000.0) for name in error
    }
    if all(error[name] <= limit[name] for name in error):
        return error
    worst = max(error, key=lambda name: error[name] / limit[name])
    what = f'camera "{worst}" is {error[worst]:.1f} px away from the points that were pointed at'
    left = {}
    for name in error:
        others = [{k: pixel for k, pixel in pixels.items() if k != name} for pixels in points]
        rest = reprojection_errors(cameras, others)
        if len(rest) >= 2:
            left[name] = max(rest[other] / limit[other] for other in rest)
    culprit = min(left, key=left.__getitem__, default=None)
    if culprit is None or left[culprit] > 1.0:
        raise fault(where, what, "cameras in one frame of reference, and pixels of one point")
    alone = _own_error(cameras, points, culprit)
    raise fault(
        where,
        f'camera "{culprit}" is {alone:.1f} px away from where the others, which agree, put the points',
        f'its pose corrected, its pixels corrected, or "{culprit}" left out',
    )


def _own_error(cameras: Mapping[str, Camera], points: Sequence[Mapping[str, np.ndarray]], name: str) -> float:
    """Reprojection error [px] of one camera for points that the others fix."""
    squares = []
    for pixels in points:
        others = [k for k in pixels if k != name]
        if name in pixels and len(others) >= 2:
            place = triangulate([cameras[k] for k in others], np.array([pixels[k] for k in others]))
            squares.append(((cameras[name].project(place[None])[0][0] - pixels[name]) ** 2).sum())
    return float(np.sqrt(np.mean(squares))) if squares else float("nan")


def _length(photographs: Sequence[Photograph]) -> float:
    """The longest way across any silhouette [m], at the distance of the middle of the visual hull.

    The hull itself says less of the size: few views leave much to it that is not of the object.
    """
    middle = visual_hull(photographs, resolution=_HULL).centres.mean(axis=0)
    angle = np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    longest = 0.0
    for photograph in photographs:
        row, column = np.nonzero(photograph.mask >= 0.5)
        depth = float(photograph.camera.project(middle[None])[1][0])
        place = np.stack([column, row], axis=1) / photograph.camera.focal * depth
        along = place @ np.stack([np.cos(angle), np.sin(angle)])
        longest = max(longest, float(np.ptp(along, axis=0).max()))
    return longest


def _histogram(photographs: Sequence[Photograph]) -> np.ndarray:
    """Shares of the object's pixels by colour, brightness divided out: (bins^2,) of red and green shares."""
    colours = np.concatenate([p.colour[p.mask >= 0.99] for p in photographs])
    share = colours[:, :2] / np.maximum(colours.sum(axis=1, keepdims=True), 1e-3)
    cell = np.minimum((share * _BINS).astype(int), _BINS - 1)
    counts = np.bincount(cell[:, 0] * _BINS + cell[:, 1], minlength=_BINS**2)
    return counts / max(counts.sum(), 1)
