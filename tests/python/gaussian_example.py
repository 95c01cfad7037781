"""Random Gaussians and a camera that sees them, for tests of rendering."""

from __future__ import annotations

import numpy as np
import torch

from mphygs.capture.cameras import Camera, looking_at
from mphygs.scene.gaussians import Gaussians


def camera(width: int = 40, height: int = 30, name: str = "front") -> Camera:
    """A camera 0.5 m from the origin, its principal point off the middle."""
    return Camera(
        name=name,
        width=width,
        height=height,
        focal=np.array([1.6 * width, 1.5 * width]),
        centre=np.array([0.53 * width, 0.46 * height]),
        camera_from_world=looking_at(np.array([0.3, -0.4, 0.1]), np.zeros(3)),
    )


def gaussians(
    count: int = 30, *, degree: int = 3, features: int = 2, size: float = 0.012, seed: int = 0
) -> Gaussians:
    """Gaussians in a ball of about 0.1 m, float64; some are flat, long, faint or nearly opaque."""
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=draw, dtype=torch.float64)

    return Gaussians(
        positions=0.05 * normal(count, 3),
        rotations=normal(count, 4),
        scales=size * torch.exp(0.7 * normal(count, 3)),
        opacities=torch.sigmoid(1.0 + 2.0 * normal(count)),
        harmonics=0.4 * normal(count, (degree + 1) ** 2, 3),
        features=normal(count, features),
    )
