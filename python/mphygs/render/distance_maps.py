"""How far outside the observed silhouette the Gaussians' centres fall: the loss L_DT."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from torch import Tensor

from mphygs.capture.cameras import Camera
from mphygs.render.projection import project_points


def distance_map(mask: np.ndarray) -> Tensor:
    """Distance (H, W) [px] of each pixel to the nearest pixel of the mask (H, W), 0 inside; float32.

    Pixels from 0.5 on are the object. Raises ValueError where there are none.
    """
    outside = (np.asarray(mask) < 0.5).astype(np.uint8)
    if outside.all():
        raise ValueError("mask: is empty; expected pixels of the object")
    return torch.from_numpy(cv2.distanceTransform(outside, cv2.DIST_L2, cv2.DIST_MASK_PRECISE))


def sampled_map(values: Tensor, pixels: Tensor) -> Tensor:
    """Values (H, W) at pixels (N, 2) [px], bilinear between pixel centres, those of the edge beyond it."""
    height, width = values.shape
    size = pixels.new_tensor([width, height])
    grid = 2 * pixels / size - 1
    sampled = torch.nn.functional.grid_sample(
        values[None, None].to(pixels.dtype),
        grid[None, None],
        mode="bilinear",
        padding_mode="border",
        align_corners=False,
    )
    return sampled[0, 0, 0]


def distance_loss(positions: Tensor, cameras: Sequence[Camera], maps: Sequence[Tensor]) -> Tensor:
    """L_DT: mean over views and Gaussians of the distance map at the projected centre [px].

    positions: (N, 3) [m]; maps: (H, W) [px] a camera, from `distance_map`. A centre behind a camera counts
    nothing there; one beside the picture counts as the nearest pixel of its edge.
    """
    if len(cameras) != len(maps) or not cameras:
        raise ValueError(f"{len(cameras)} cameras and {len(maps)} maps; expected one map a camera")
    losses = []
    for camera, values in zip(cameras, maps, strict=True):
        if tuple(values.shape) != (camera.height, camera.width):
            size = f"{camera.height} x {camera.width}"
            raise ValueError(f'camera "{camera.name}": map is {tuple(values.shape)}; expected {size}')
        front = project_points(camera, positions.detach())[1] > 0
        pixels, _ = project_points(camera, positions[front])
        losses.append(sampled_map(values, pixels).sum() / max(len(positions), 1))
    return torch.stack(losses).mean()
