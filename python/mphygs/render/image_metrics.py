"""How like a photograph a rendered picture is: PSNR, IoU and 2D chamfer distance."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import astuple, dataclass

import cv2
import numpy as np

from mphygs.capture.views import Photograph
from mphygs.render.picture import Picture

_BEST_PSNR = 100.0  # [dB], of equal pictures


@dataclass(frozen=True)
class ImageMetrics:
    """psnr: [dB], background black in both; iou: 0 to 1; chamfer_px: [px]."""

    psnr: float
    iou: float
    chamfer_px: float


def peak_signal_to_noise(rendered: np.ndarray, observed: np.ndarray) -> float:
    """10 log10(1 / mean squared difference) [dB] of pictures of one shape, 0 to 1; at most 100."""
    if rendered.shape != observed.shape:
        raise ValueError(f"pictures have shapes {rendered.shape} and {observed.shape}; expected one shape")
    error = float(np.mean((np.asarray(rendered, np.float64) - observed) ** 2))
    return _BEST_PSNR if error <= 10 ** (-_BEST_PSNR / 10) else -10 * math.log10(error)


def intersection_over_union(first: np.ndarray, second: np.ndarray) -> float:
    """Share of the pixels in either mask (H, W), from 0.5 on, that are in both; 1 where both are empty."""
    a, b = _silhouettes(first, second)
    either = int((a | b).sum())
    return float((a & b).sum() / either) if either else 1.0


def chamfer_distance(first: np.ndarray, second: np.ndarray) -> float:
    """Mean distance [px] from each pixel of one mask (H, W) to the other mask, mean of both directions.

    0 where both are empty; the diagonal of the picture where one is.
    """
    a, b = _silhouettes(first, second)
    if not a.any() or not b.any():
        return 0.0 if a.any() == b.any() else math.hypot(*a.shape)
    return 0.5 * (_mean_distance(a, b) + _mean_distance(b, a))


def _silhouettes(first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    a, b = np.asarray(first) >= 0.5, np.asarray(second) >= 0.5
    if a.shape != b.shape:
        raise ValueError(f"masks have shapes {a.shape} and {b.shape}; expected one shape")
    return a, b


def _mean_distance(source: np.ndarray, target: np.ndarray) -> float:
    away = cv2.distanceTransform((~target).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return float(away[source].mean())


def mean_metrics(metrics: Iterable[ImageMetrics]) -> ImageMetrics:
    """The mean of each metric over frames and views. Raises ValueError where there are none."""
    rows = [astuple(each) for each in metrics]
    if not rows:
        raise ValueError("metrics: are none; expected at least one picture")
    return ImageMetrics(*(float(value) for value in np.mean(rows, axis=0)))


def image_metrics(picture: Picture, photograph: Photograph) -> ImageMetrics:
    """The metrics of a picture, rendered without background, against what one camera saw."""
    opacity = picture.opacity.detach().numpy()
    observed = photograph.colour * photograph.mask[..., None]
    return ImageMetrics(
        psnr=peak_signal_to_noise(np.clip(picture.colour.detach().numpy(), 0, 1), observed),
        iou=intersection_over_union(opacity, photograph.mask),
        chamfer_px=chamfer_distance(opacity, photograph.mask),
    )
