"""Splatting by the compiled kernel, as a torch operation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from mphygs import _core
from mphygs.capture.cameras import Camera
from mphygs.render.picture import (
    Optics,
    Picture,
    checked_background,
    checked_screen_offsets,
    picture_of,
)
from mphygs.scene.gaussians import Gaussians


def splat(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: Tensor | None = None,
    screen_offsets: Tensor | None = None,
    optics: Optics = Optics(),  # noqa: B008 (frozen)
    threads: int | None = None,
) -> Picture:
    """What `camera`, its lens distortion undone, sees of `gaussians`.

    gaussians: float32, on the CPU; background: (3,) or (H, W, 3) colour behind them, black where None;
    screen_offsets: (N, 2) added to the projected centres [px], whose gradient tells where Gaussians are too
    few; threads: None for as many as torch uses. The same bits for any number of threads. First derivatives
    with respect to all tensors; EWA projection (Zwicker et al. 2001) and compositing as in Kerbl et al. 2023.
    Raises ValueError for shapes that do not fit and TypeError for other numbers than float32.
    """
    checked_background(background, camera)
    checked_screen_offsets(screen_offsets, gaussians)
    tensors = [*gaussians.tensors(), *([] if screen_offsets is None else [screen_offsets])]
    for tensor in tensors:
        if tensor.dtype != torch.float32 or tensor.device.type != "cpu":
            raise TypeError(f"gaussians: are {tensor.dtype} on {tensor.device}; expected float32 on the CPU")
    count = torch.get_num_threads() if threads is None else threads
    if count < 1:
        raise ValueError(f"threads: {count}; expected at least 1")
    if not (math.isfinite(optics.blur) and optics.blur > 0 and optics.nearest > 0):
        raise ValueError(f"optics: blur {optics.blur} and nearest {optics.nearest}; expected both above zero")
    image, transmittance, visible = _Splatting.apply(
        *gaussians.tensors(), screen_offsets, _core_camera(camera, optics), count
    )
    return picture_of(image, transmittance, visible, background)


def _core_camera(camera: Camera, optics: Optics) -> Any:
    return _core.SplatCamera(
        width=camera.width,
        height=camera.height,
        focal=camera.focal,
        centre=camera.centre,
        camera_from_world=camera.camera_from_world,
        nearest=optics.nearest,
        blur=optics.blur,
    )


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


class _Splatting(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, *arguments: Any) -> tuple[Tensor, Tensor, Tensor]:
        tensors, (camera, threads) = arguments[:7], arguments[7:]
        # saved so that torch notices a change in place before backward, which reads them again
        ctx.save_for_backward(*tensors)
        names = ("positions", "rotations", "scales", "opacities", "harmonics", "features", "screen_offsets")
        arrays = {
            name: None if tensor is None else _array(tensor)
            for name, tensor in zip(names, tensors, strict=True)
        }
        ctx.picture = _core.SplatPicture(camera=camera, threads=threads, **arrays)
        ctx.threads = threads
        visible = torch.from_numpy(ctx.picture.order.astype(np.int64))
        ctx.mark_non_differentiable(visible)
        return torch.from_numpy(ctx.picture.image), torch.from_numpy(ctx.picture.transmittance), visible

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, image_bar: Tensor, transmittance_bar: Tensor, _: Tensor) -> tuple[Any, ...]:
        tensors = ctx.saved_tensors
        gradients = ctx.picture.backward(_array(image_bar), _array(transmittance_bar), ctx.threads)
        used = [
            None if tensor is None else torch.from_numpy(gradient)
            for tensor, gradient in zip(tensors, gradients, strict=True)
        ]
        return *used, None, None
