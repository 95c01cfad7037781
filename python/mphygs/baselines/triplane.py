"""A smooth field in a box: three planes of features, and a small network of what a point sees in them.

Zhang et al., "PhysDreamer: physics-based interaction with 3D objects via video generation" (2024), after
Cao and Johnson, "HexPlane: a fast representation for dynamic scenes" (2023).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import grid_sample

# Points to a side of a plane, its channels, and units of the layer behind.
RESOLUTION, CHANNELS, WIDTH = 8, 8, 32
RATES = {"planes": 0.02, "weight0": 0.01, "bias0": 0.01, "weight1": 0.01}


def shapes(outputs: int) -> dict[str, tuple[int, ...]]:
    """Of the weights of a field with so many numbers at a point, by name."""
    return {
        "planes": (3, CHANNELS, RESOLUTION, RESOLUTION),
        "weight0": (WIDTH, 3 * CHANNELS),
        "bias0": (WIDTH,),
        "weight1": (outputs, WIDTH),
    }


def flat_weights(outputs: int, generator: np.random.Generator) -> dict[str, np.ndarray]:
    """Weights of a field that is zero everywhere."""
    out = {name: np.zeros(shape) for name, shape in shapes(outputs).items()}
    out["planes"] = 0.1 * generator.standard_normal(out["planes"].shape)
    out["weight0"] = generator.standard_normal(out["weight0"].shape) / np.sqrt(3 * CHANNELS)
    return out


def field_at(weights: Mapping[str, Tensor], points: Tensor, box: np.ndarray) -> Tensor:
    """(N, K) of a field at points (N, 3) [m]. box: (2, 3) [m] of the object."""
    low, high = (torch.as_tensor(side, dtype=points.dtype) for side in box)
    at = torch.clamp(2.0 * (points - low) / (high - low) - 1.0, -1.0, 1.0)
    seen = []
    for plane, axes in zip(weights["planes"], ([0, 1], [0, 2], [1, 2]), strict=True):
        seen.append(grid_sample(plane[None], at[None, None][..., axes], align_corners=True)[0, :, 0].T)
    hidden = torch.relu(torch.cat(seen, dim=1) @ weights["weight0"].T + weights["bias0"])
    return hidden @ weights["weight1"].T


def total_variation(planes: np.ndarray) -> tuple[float, np.ndarray]:
    """Total variation of planes, a mean over their points, and its derivative by them."""
    own = torch.as_tensor(planes, dtype=torch.float32).clone().requires_grad_()
    rough = (own[..., 1:, :] - own[..., :-1, :]).abs().mean() + (own[..., 1:] - own[..., :-1]).abs().mean()
    rough.backward()
    return float(rough.detach()), own.grad.numpy().astype(float)
