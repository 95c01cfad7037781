"""Pictures of Gaussians from all sides, where an object is given without photographs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from mphygs.capture.cameras import Camera, looking_at
from mphygs.capture.views import Photograph
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians

_DISTANCE = 5.0  # of the cameras, in radii of the object
_FILLED = 0.9  # share of half a picture that the object reaches
_GOLDEN = np.pi * (3.0 - np.sqrt(5.0))


def pictures_all_round(gaussians: Gaussians, *, count: int = 32, size: int = 256) -> list[Photograph]:
    """`count` pictures of size x size pixels from cameras spread evenly over a sphere about the Gaussians.

    The mask is what is opaque. Gaussians that count for little (opacity below 0.05) do not set the frame.
    """
    solid = gaussians.opacities.detach().numpy() >= 0.05
    points = gaussians.positions.detach().double().numpy()[solid]
    if len(points) == 0:
        raise ValueError("gaussians: none is opaque; expected an object that can be seen")
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    # a Gaussian is seen to about two standard deviations from its centre
    reach = 2.0 * gaussians.scales.detach().double().numpy()[solid].max(axis=1)
    radius = float((np.linalg.norm(points - middle, axis=1) + reach).max())
    # what is a radius from the axis at that distance lies `_FILLED` of half a picture from the middle
    focal = np.full(2, 0.5 * size * _FILLED * _DISTANCE)
    # nearly even on the sphere, its poles left out: the line of sight must not be along up
    height = np.arcsin(0.97 * (1.0 - 2.0 * (np.arange(count) + 0.5) / count))
    pictures = []
    for number in range(count):
        bearing = _GOLDEN * number
        direction = np.array(
            [np.cos(bearing) * np.cos(height[number]), np.sin(bearing) * np.cos(height[number]),
             np.sin(height[number])]
        )  # fmt: skip
        place = middle + _DISTANCE * radius * direction
        pose = looking_at(place, middle)
        camera = Camera(f"round{number:02d}", size, size, focal, np.full(2, 0.5 * size), pose)
        with torch.no_grad():
            picture = splat(gaussians, camera)
        mask = picture.opacity.numpy()
        colour = picture.colour.clamp(0, 1).numpy()
        pictures.append(Photograph(camera, colour, np.clip(mask, 0, 1)))
    return pictures


def seen_depths(gaussians: Gaussians, photographs: Sequence[Photograph]) -> list[np.ndarray]:
    """Mean depth (H, W) [m], float32, of the Gaussians in every picture, infinite where they are less than
    half opaque."""
    depths = []
    for photograph in photographs:
        with torch.no_grad():
            depth = splat(gaussians, photograph.camera).mean_depth(0.5).numpy()
        depths.append(np.where(np.isfinite(depth), depth, np.inf).astype(np.float32))
    return depths
