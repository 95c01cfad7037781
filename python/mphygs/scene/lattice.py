"""A regular lattice of voxels over an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import map_coordinates


@dataclass(frozen=True, eq=False)
class Lattice:
    """corner: (3,), centre of voxel (0, 0, 0) [m]; spacing: [m]; shape: voxels along each axis."""

    corner: np.ndarray
    spacing: float
    shape: tuple[int, int, int]

    @classmethod
    def about(cls, points: np.ndarray, *, spacing: float, margin: float) -> Lattice:
        """The lattice over points (N, 3) [m] and `margin` [m] more on every side."""
        if not spacing > 0 or len(points) == 0 or not np.isfinite(points).all():
            raise ValueError(f"{len(points)} points, spacing {spacing}; expected finite points, above zero")
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        shape = np.ceil((high - low) / spacing).astype(int) + 1
        middle = 0.5 * (low + high)
        corner = middle - 0.5 * spacing * (shape - 1)
        return cls(corner, spacing, tuple(int(n) for n in shape))

    @property
    def count(self) -> int:
        """Number of voxels."""
        return int(np.prod(self.shape))

    def points(self, index: np.ndarray | None = None) -> np.ndarray:
        """Centres (M, 3) [m] of the voxels with flat indices `index` (M,), all where None."""
        if index is None:
            index = np.arange(self.count)
        return self.corner + self.spacing * np.stack(np.unravel_index(index, self.shape), axis=1)

    def at(self, values: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Voxel values (X, Y, Z) at points (N, 3) [m], by trilinear interpolation, held at the edge; (N,)."""
        place = (np.asarray(points) - self.corner) / self.spacing
        return map_coordinates(values, place.T, order=1, mode="nearest")
