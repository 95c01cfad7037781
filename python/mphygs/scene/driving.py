"""Gaussians that follow the particles they lie among."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from mphygs.scene.gaussians import Gaussians
from mphygs.scene.tensor_rotation import polar_rotation, quaternion_product, quaternions_of_rotations

NEIGHBOURS = 4


@dataclass(frozen=True, eq=False)
class Binding:
    """Which particles N Gaussians follow. neighbours: (N, K) indices, the nearest first; weights: (N, K), sum
    1; offsets: (N, K, 3), from each of them to the Gaussian at rest [m]."""

    neighbours: Tensor
    weights: Tensor
    offsets: Tensor


def bind(gaussians: Gaussians, particles: Tensor, *, neighbours: int = NEIGHBOURS) -> Binding:
    """Bind Gaussians to the nearest resting particles (P, 3) [m], weighted by inverse squared distance.

    Raises ValueError where there are fewer particles than neighbours.
    """
    if not 1 <= neighbours <= len(particles):
        raise ValueError(f"neighbours: {neighbours} of {len(particles)} particles; expected 1 to that many")
    rest = particles.detach().numpy()
    places = gaussians.positions.detach().numpy()
    distance, index = cKDTree(rest).query(places, k=range(1, neighbours + 1))
    # softened, so that a Gaussian upon a particle has finite weights
    soft = 1e-2 * np.median(distance[:, 0]) + 1e-9
    weights = 1 / (distance**2 + soft**2)
    weights /= weights.sum(axis=1, keepdims=True)
    dtype = particles.dtype
    return Binding(
        neighbours=torch.from_numpy(index),
        weights=torch.from_numpy(weights).to(dtype),
        offsets=torch.from_numpy(places[:, None] - rest[index]).to(dtype),
    )


def driven(gaussians: Gaussians, binding: Binding, positions: Tensor, deformation: Tensor) -> Gaussians:
    """The Gaussians where the particles have carried them, differentiable in positions and deformation.

    positions: (P, 3) [m]; deformation: (P, 3, 3), gradients F. A Gaussian moves to the weighted mean of
    x_p + F_p offset and turns by the weighted mean of the particles' polar rotations; size, opacity, colour
    (Lambertian: harmonics above degree 0 are not turned) and features stay.
    """
    weights, index = binding.weights, binding.neighbours
    carried = (deformation[index] @ binding.offsets[..., None])[..., 0]
    places = (weights[..., None] * (positions[index] + carried)).sum(dim=1)
    turns = quaternions_of_rotations(polar_rotation(deformation))[index]
    # q and -q are one rotation: all on the side of the nearest particle's
    side = torch.where((turns * turns[:, :1]).sum(-1, keepdim=True) < 0, -1.0, 1.0)
    turn = torch.nn.functional.normalize((weights[..., None] * side * turns).sum(dim=1), dim=-1)
    dtype = gaussians.positions.dtype
    return replace(
        gaussians,
        positions=places.to(dtype),
        rotations=quaternion_product(turn.to(dtype), gaussians.rotations),
    )
