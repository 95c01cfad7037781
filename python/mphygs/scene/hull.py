"""The visual hull: what of space every silhouette leaves to the object (Laurentini 1994)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.capture.errors import CaptureError, fault
from mphygs.capture.views import Photograph

_COARSE = 32  # voxels along the longest side of the first look
# of every silhouette, by the first and by the last hull of cameras and masks that fit together
_LEAST_COVERED = (0.6, 0.85)
_SEEING_SHARE = 0.5  # of the views; fewer say too little of a voxel


@dataclass(frozen=True, eq=False)
class VisualHull:
    """Voxels on a regular lattice. occupied: (X, Y, Z) bool; corner: (3,), centre of voxel (0, 0, 0) [m];
    spacing: [m]."""

    occupied: np.ndarray
    corner: np.ndarray
    spacing: float

    @property
    def centres(self) -> np.ndarray:
        """Centres (M, 3) [m] of the occupied voxels."""
        return self.corner + self.spacing * np.argwhere(self.occupied)

    @property
    def surface(self) -> np.ndarray:
        """Centres (M, 3) [m] of the occupied voxels of which one of the six neighbours is empty."""
        padded = np.pad(self.occupied, 1)
        inner = self.occupied.copy()
        for axis in range(3):
            for step in (-1, 1):
                inner &= np.roll(padded, step, axis=axis)[1:-1, 1:-1, 1:-1]
        return self.corner + self.spacing * np.argwhere(self.occupied & ~inner)


def visual_hull(photographs: Sequence[Photograph], *, resolution: int = 64) -> VisualHull:
    """The visual hull of the masks, `resolution` voxels along its longest side.

    A voxel stays where the masks of all views that have it in their picture, at least half of all, show
    the object within half a voxel of its centre.
    Raises CaptureError where the masks leave nothing, or so little that they and the cameras cannot belong
    together; the view is named without which the others agree.
    """
    if resolution < 2:
        raise ValueError(f"resolution: {resolution}; expected at least 2")
    centre, radius = _surroundings(photographs)
    spacing = 2 * radius / _COARSE
    lattice = _lattice(np.full(3, _COARSE), centre - radius + spacing / 2, spacing)
    rejected, seen = _votes(photographs, lattice.reshape(-1, 3), reach=0.87 * spacing)
    _check_agreement(photographs, lattice.reshape(-1, 3), rejected, seen, spacing, _LEAST_COVERED[0])
    coarse = lattice.reshape(-1, 3)[_kept(rejected, seen)]
    low, high = coarse.min(0) - spacing, coarse.max(0) + spacing
    spacing = float((high - low).max()) / resolution
    shape = np.ceil((high - low) / spacing - 1e-9).astype(int)
    corner = low + spacing / 2
    points = _lattice(shape, corner, spacing).reshape(-1, 3)
    # half a voxel, so that what is thinner than one is not lost between two centres
    rejected, seen = _votes(photographs, points, reach=0.5 * spacing)
    _check_agreement(photographs, points, rejected, seen, spacing, _LEAST_COVERED[1])
    return VisualHull(_kept(rejected, seen).reshape(shape), corner, spacing)


def silhouette_votes(photographs: Sequence[Photograph], points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How many views show points (N, 3) [m] within their mask; how many have them in their picture; (N,)."""
    rejected, seen = _votes(photographs, points, reach=0.0)
    return (seen & ~rejected).sum(0), seen.sum(0)


def _lattice(shape: np.ndarray, corner: np.ndarray, spacing: float) -> np.ndarray:
    axes = [corner[k] + spacing * np.arange(shape[k]) for k in range(3)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)


def _surroundings(photographs: Sequence[Photograph]) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius [m] of a ball about the object: where the lines of sight through the middle of
    the masks come closest together, and the largest silhouette at that distance."""
    projectors, targets, middles = [], [], []
    for photograph in photographs:
        v, u = np.nonzero(photograph.mask >= 0.5)
        pixels = np.stack([u, v], axis=1) + 0.5
        middle = 0.5 * (pixels.min(0) + pixels.max(0))
        middles.append(float(np.linalg.norm(pixels - middle, axis=1).max()))
        ray = photograph.camera.rays(middle)
        projectors.append(np.eye(3) - np.outer(ray, ray))
        targets.append(projectors[-1] @ photograph.camera.position)
    matrix = np.sum(projectors, axis=0)
    if np.linalg.eigvalsh(matrix)[0] < 1e-3:
        raise _disagreement(photographs, "look along one direction", None)
    centre = np.linalg.solve(matrix, np.sum(targets, axis=0))
    radius = 0.0
    for photograph, size in zip(photographs, middles, strict=True):
        depth = photograph.camera.project(centre[None])[1][0]
        if depth <= 0:
            raise _disagreement(photographs, "do not look at one place", photograph.camera.name)
        radius = max(radius, (size + 1) * depth / float(photograph.camera.focal.min()))
    return centre, 1.2 * radius


def _votes(
    photographs: Sequence[Photograph], points: np.ndarray, *, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """Which views (V, N) say that a point, or a ball of radius `reach` [m] about it, is not of the object;
    which have it in their picture."""
    rejected = np.zeros((len(photographs), len(points)), dtype=bool)
    seen = np.zeros_like(rejected)
    for index, photograph in enumerate(photographs):
        camera = photograph.camera
        pixels, depth = camera.project(points)
        inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < [camera.width, camera.height]).all(1)
        column, row = pixels[inside].astype(int).T
        mask = photograph.mask >= 0.5
        if reach > 0:
            radius = int(np.ceil(reach * camera.focal.max() / max(float(depth[inside].min(initial=1)), 1e-9)))
            mask = _grown(mask, radius)
        seen[index] = inside
        rejected[index, inside] = ~mask[row, column]
    return rejected, seen


def _grown(mask: np.ndarray, radius: int) -> np.ndarray:
    """The mask with every pixel grown to a square of 2 radius + 1."""
    for axis in (0, 1):
        total = np.cumsum(
            np.pad(mask.astype(int), [(radius + 1, radius) if k == axis else (0, 0) for k in (0, 1)]), axis
        )
        last = np.take(total, np.arange(2 * radius + 1, total.shape[axis]), axis)
        first = np.take(total, np.arange(0, total.shape[axis] - 2 * radius - 1), axis)
        mask = last > first
    return mask


def _kept(rejected: np.ndarray, seen: np.ndarray) -> np.ndarray:
    return ~rejected.any(0) & (seen.sum(0) >= max(_SEEING_SHARE * len(seen), 2))


def _check_agreement(
    photographs: Sequence[Photograph],
    points: np.ndarray,
    rejected: np.ndarray,
    seen: np.ndarray,
    spacing: float,
    least: float,
) -> None:
    """Raise CaptureError unless the hull covers the share `least` of every silhouette."""
    worst = _least_covered(photographs, points[_kept(rejected, seen)], spacing)
    if worst >= least:
        return
    without = []
    for index in range(len(photographs)):
        others = np.arange(len(photographs)) != index
        hull = points[_kept(rejected[others], seen[others])]
        without.append(_least_covered([photographs[k] for k in np.flatnonzero(others)], hull, spacing))
    best = int(np.argmax(without))
    culprit = photographs[best].camera.name if without[best] >= least else None
    raise _disagreement(
        photographs, f"agree on too little (a hull that covers {worst:.0%} of a mask)", culprit
    )


def _least_covered(photographs: Sequence[Photograph], hull: np.ndarray, spacing: float) -> float:
    """The smallest share of a mask that the voxels `hull` (M, 3) [m] cover."""
    least = 1.0
    for photograph in photographs:
        camera = photograph.camera
        covered = np.zeros((camera.height, camera.width), dtype=bool)
        pixels, depth = camera.project(hull)
        inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < [camera.width, camera.height]).all(1)
        if inside.any():
            column, row = pixels[inside].astype(int).T
            covered[row, column] = True
            covered = _grown(covered, int(np.ceil(0.5 * spacing * camera.focal.max() / depth[inside].min())))
        mask = photograph.mask >= 0.5
        least = min(least, float(covered[mask].mean()))
    return least


def _disagreement(photographs: Sequence[Photograph], what: str, culprit: str | None) -> CaptureError:
    expected = "cameras and masks of one object, in one frame of reference"
    if culprit is not None:
        what = f'{what}; without view "{culprit}" the others agree'
        expected = f'the pose or the mask of "{culprit}" corrected, or the view left out'
    return fault(f"{len(photographs)} views", what, expected)
