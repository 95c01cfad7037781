"""What is drawn of an object that moves: its Gaussians, carried by a few of its particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from mphygs.scene.driving import Binding, bind, driven
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.tensor_rotation import polar_rotation

# Particles that carry the Gaussians, about, and neighbours that tell how each one turns.
CARRIER_COUNT, NEIGHBOURS = 1500, 12


@dataclass(frozen=True, eq=False)
class CarriedGaussians:
    """Gaussians at rest and the particles that carry them.

    gaussians: float32; carriers: (P, 3) particles at rest [m]; binding: of the Gaussians to them;
    neighbours: (P, K) carriers around each, whose offsets at rest (P, K, 3) [m] show its rotation.
    """

    gaussians: Gaussians
    carriers: np.ndarray
    binding: Binding
    neighbours: Tensor
    offsets: Tensor

    @classmethod
    def of(
        cls, gaussians: Gaussians, particles: np.ndarray, *, count: int = CARRIER_COUNT
    ) -> CarriedGaussians:
        """particles: (N, 3) [m], of which about `count` carry. Raises ValueError where they are too few."""
        carriers = thinned(particles, count)
        if len(carriers) <= NEIGHBOURS:
            raise ValueError(f"{len(carriers)} particles; expected more than {NEIGHBOURS} to carry Gaussians")
        near = cKDTree(carriers).query(carriers, k=NEIGHBOURS + 1)[1][:, 1:]
        rest = torch.from_numpy(carriers)
        single = gaussians.each(lambda tensor: tensor.detach().to(torch.float32))
        binding = bind(single, rest)
        return cls(single, carriers, binding, torch.from_numpy(near), rest[near] - rest[:, None])

    def at(self, positions: Tensor) -> Gaussians:
        """The Gaussians where the carriers (P, 3) [m] have gone; differentiable in them.

        Each carrier turns by the rotation that fits its neighbours best (Kabsch 1976).
        """
        moved = positions[self.neighbours] - positions[:, None]
        turned = polar_rotation(moved.mT @ self.offsets)
        return driven(self.gaussians, self.binding, positions, turned)


def thinned(points: np.ndarray, count: int) -> np.ndarray:
    """About `count` of the points (N, 3), the one nearest the mean of each cell of a grid."""
    if len(points) <= count:
        return np.array(points)
    low = points.min(axis=0)
    small, large = 0.0, float(np.ptp(points, axis=0).max()) + 1e-12
    for _ in range(40):
        edge = 0.5 * (small + large)
        cells = len(np.unique(np.floor((points - low) / edge).astype(np.int64), axis=0))
        small, large = (edge, large) if cells > count else (small, edge)
    _, cell = np.unique(np.floor((points - low) / large).astype(np.int64), axis=0, return_inverse=True)
    cell = cell.ravel()
    members = np.bincount(cell)
    mean = np.stack([np.bincount(cell, points[:, axis]) / members for axis in range(3)], axis=1)
    away = np.linalg.norm(points - mean[cell], axis=1)
    order = np.lexsort((away, cell))
    first = np.r_[True, np.diff(cell[order]) > 0]
    return points[order[first]]
