"""Gaussians to begin a reconstruction with, on points of the object's surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from mphygs.capture.colmap import ColmapPoints
from mphygs.capture.views import Photograph
from mphygs.scene.gaussians import Gaussians, harmonics_of_colour
from mphygs.scene.hull import silhouette_votes, visual_hull

LEAST_POINTS = 100
_NEIGHBOURS = 3
_FIRST_OPACITY = 0.3


def points_within_masks(photographs: Sequence[Photograph], points: ColmapPoints) -> ColmapPoints:
    """Those of a COLMAP model's points that every view having them in its picture shows within its mask."""
    within, seen = silhouette_votes(photographs, points.positions)
    kept = (within == seen) & (seen >= 2)
    return ColmapPoints(points.positions[kept], points.colours[kept], points.numbers[kept])


def first_points(
    photographs: Sequence[Photograph], colmap: ColmapPoints | None, *, resolution: int
) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) [m] and colours (N, 3), 0 to 1.

    COLMAP's points within all masks where there are at least a hundred; else the surface of the visual hull,
    `resolution` voxels long, each point of the median colour of the views that have it in their mask.
    Raises CaptureError where the masks and cameras cannot belong together.
    """
    hull = visual_hull(photographs, resolution=resolution)
    if colmap is not None:
        inside = points_within_masks(photographs, colmap)
        if len(inside.positions) >= LEAST_POINTS:
            return inside.positions, inside.colours
    points = hull.surface
    seen = np.full((len(photographs), len(points), 3), np.nan)
    for index, photograph in enumerate(photographs):
        inside, row, column = _pixels_within(photograph, points)
        seen[index, inside] = photograph.colour[row, column]
    grey = np.isnan(seen).all(axis=0)
    seen[0][grey] = 0.5
    return points, np.nanmedian(seen, axis=0)


def mean_features(
    photographs: Sequence[Photograph], maps: Sequence[Tensor], points: np.ndarray
) -> np.ndarray:
    """Mean (N, F) over views of maps (h, w, F) where points (N, 3) [m] fall into the mask; 0 where none."""
    total = np.zeros((len(points), maps[0].shape[2]))
    count = np.zeros((len(points), 1))
    for photograph, values in zip(photographs, maps, strict=True):
        inside, row, column = _pixels_within(photograph, points)
        height, width = values.shape[:2]
        rows = row * height // photograph.camera.height
        columns = column * width // photograph.camera.width
        total[inside] += values.detach().numpy()[rows, columns]
        count[inside] += 1
    return total / np.maximum(count, 1)


def gaussians_at(positions: np.ndarray, colours: np.ndarray, features: np.ndarray) -> Gaussians:
    """Round, faint Gaussians (float32) as wide as the mean distance to the three nearest others.

    positions: (N, 3) [m], N at least 4; colours: (N, 3), 0 to 1; features: (N, F).
    """
    if len(positions) <= _NEIGHBOURS:
        raise ValueError(f"{len(positions)} points; expected at least {_NEIGHBOURS + 1}")
    distance = cKDTree(positions).query(positions, k=_NEIGHBOURS + 1)[0][:, 1:].mean(axis=1)
    count = len(positions)
    return Gaussians(
        positions=torch.as_tensor(positions, dtype=torch.float32),
        rotations=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        scales=torch.as_tensor(np.maximum(distance, 1e-7), dtype=torch.float32)[:, None].repeat(1, 3),
        opacities=torch.full((count,), _FIRST_OPACITY),
        harmonics=harmonics_of_colour(torch.as_tensor(colours, dtype=torch.float32)),
        features=torch.as_tensor(features, dtype=torch.float32),
    )


def _pixels_within(photograph: Photograph, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices of the points (N, 3) that fall into the mask, and their rows and columns."""
    camera = photograph.camera
    pixels, depth = camera.project(points)
    inside = (depth > 0) & (pixels >= 0).all(1) & (pixels < [camera.width, camera.height]).all(1)
    index = np.flatnonzero(inside)
    column, row = pixels[index].astype(int).T
    masked = photograph.mask[row, column] >= 0.5
    return index[masked], row[masked], column[masked]
