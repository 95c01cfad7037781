"""How unlike two pictures are, as differentiable losses: L1, structural similarity, feature maps."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, conv2d

from mphygs import _core

_WINDOW = 11  # pixels
_SIGMA = 1.5  # pixels
_C1, _C2 = 0.01**2, 0.03**2  # for colours from 0 to 1
DSSIM_SHARE = 0.2  # of 3DGS's loss


def _planes(image: Tensor) -> Tensor:
    """(H, W, C) as (C, 1, H, W)."""
    return image.permute(2, 0, 1)[:, None]


def _checked(rendered: Tensor, observed: Tensor) -> None:
    if rendered.ndim != 3 or rendered.shape != observed.shape:
        have, want = tuple(rendered.shape), tuple(observed.shape)
        raise ValueError(f"pictures have shapes {have} and {want}; expected (H, W, C) twice")


def structural_similarity(rendered: Tensor, observed: Tensor) -> Tensor:
    """Mean structural similarity of two pictures (H, W, C), 0 to 1; 1 where they are the same.

    Gaussian window of 11 pixels, standard deviation 1.5, zero beyond the edge (Wang et al. 2004, as in 3DGS).
    Compiled for float32 pictures of which only `rendered` wants a gradient, else as `similarity_by_torch`.
    """
    _checked(rendered, observed)
    is_plain = rendered.dtype == torch.float32 == observed.dtype and rendered.device.type == "cpu"
    if is_plain and not observed.requires_grad and rendered.numel() > 0:
        return _Similarity.apply(rendered.permute(2, 0, 1), observed.permute(2, 0, 1))
    return similarity_by_torch(rendered, observed)


def similarity_by_torch(rendered: Tensor, observed: Tensor) -> Tensor:
    """As `structural_similarity`, in plain torch: slow, any precision, with respect to both pictures."""
    _checked(rendered, observed)
    a, b = _planes(rendered), _planes(observed)
    place = torch.arange(_WINDOW, dtype=a.dtype, device=a.device) - _WINDOW // 2
    window = torch.exp(-(place**2) / (2 * _SIGMA**2))
    window = window / window.sum()
    # the five moments in one pass, rows then columns
    moments = torch.cat([a, b, a * a, b * b, a * b])
    moments = conv2d(moments, window[None, None, :, None], padding=(_WINDOW // 2, 0))
    moments = conv2d(moments, window[None, None, None, :], padding=(0, _WINDOW // 2))
    mean_a, mean_b, square_a, square_b, product = moments.chunk(5)
    variance_a, variance_b = square_a - mean_a**2, square_b - mean_b**2
    covariance = product - mean_a * mean_b
    luminance = (2 * mean_a * mean_b + _C1) / (mean_a**2 + mean_b**2 + _C1)
    structure = (2 * covariance + _C2) / (variance_a + variance_b + _C2)
    return (luminance * structure).mean()


class _Similarity(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, rendered: Tensor, observed: Tensor) -> Tensor:
        value, slope = _core.structural_similarity(
            rendered.detach().contiguous().numpy(),
            observed.detach().contiguous().numpy(),
            torch.get_num_threads(),
        )
        ctx.save_for_backward(torch.from_numpy(slope))
        return rendered.new_tensor(value)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, bar: Tensor) -> tuple[Tensor, None]:
        (slope,) = ctx.saved_tensors
        return slope * bar, None


def image_loss(rendered: Tensor, observed: Tensor, *, scales: int = 1, dssim: float = DSSIM_SHARE) -> Tensor:
    """(1 - dssim) L1 + dssim (1 - SSIM) of pictures (H, W, 3), mean over `scales` resolutions.

    Each resolution has half the pixels along a side of the one before, by means; the scales end before a side
    has fewer than eight pixels. Kerbl et al. 2023, equation 7; at several scales it is the paper's L_rgb.
    """
    _checked(rendered, observed)
    if scales < 1 or not 0 <= dssim <= 1:
        raise ValueError(f"scales {scales}, dssim {dssim}; expected at least 1, and 0 to 1")
    losses = []
    for _ in range(scales):
        loss = (1 - dssim) * (rendered - observed).abs().mean()
        if dssim > 0:
            loss = loss + dssim * (1 - structural_similarity(rendered, observed))
        losses.append(loss)
        if min(rendered.shape[:2]) < 16:
            break
        rendered, observed = (
            avg_pool2d(image.permute(2, 0, 1), 2).permute(1, 2, 0) for image in (rendered, observed)
        )
    return torch.stack(losses).mean()


def feature_loss(
    rendered: Tensor, observed: Tensor, *, weight: Tensor | None = None, scales: int = 3
) -> Tensor:
    """L1 between feature maps (H, W, F) and (h, w, F), mean over `scales` resolutions (L_DINO).

    rendered is brought to the resolution of observed, which is at most as fine, by means; each further scale
    has half the pixels along a side. weight: (h, w), 1 where observed means the object; None for everywhere.
    """
    if rendered.ndim != 3 or observed.ndim != 3 or rendered.shape[2] != observed.shape[2]:
        have, want = tuple(rendered.shape), tuple(observed.shape)
        raise ValueError(f"features have shapes {have} and {want}; expected (H, W, F) and (h, w, F)")
    if scales < 1:
        raise ValueError(f"scales: {scales}; expected at least 1")
    seen, wanted = rendered.permute(2, 0, 1), observed.permute(2, 0, 1)
    if weight is None:
        weight = torch.ones_like(wanted[0])
    seen = adaptive_avg_pool2d(seen, wanted.shape[1:])
    losses = []
    for _ in range(scales):
        total = weight.sum().clamp_min(1e-6) * seen.shape[0]
        losses.append(((seen - wanted).abs() * weight).sum() / total)
        if min(seen.shape[1:]) < 4:
            break
        seen, wanted = avg_pool2d(seen, 2), avg_pool2d(wanted, 2)
        weight = avg_pool2d(weight[None], 2)[0]
    return torch.stack(losses).mean()
