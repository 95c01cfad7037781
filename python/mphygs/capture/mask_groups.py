"""Groups of pixels that belong together, at several scales: superpixels, or what a segmenter finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from skimage.segmentation import felzenszwalb

from mphygs.capture.views import Photograph


class MaskGrouper(Protocol):
    """Whatever finds groups of pixels in a picture.

    name: how results name it.
    """

    name: str

    def groups_of(self, photograph: Photograph) -> list[np.ndarray]:
        """(h, w) int32 group numbers, one a scale, -1 for none; groups of one scale do not overlap."""
        ...


@dataclass(frozen=True)
class Superpixels:
    """Superpixels of the object (Felzenszwalb and Huttenlocher 2004), from fine to coarse.

    scales: their preference for large groups, for colours of 0 to 1; smoothing: of the picture before,
    standard deviation [px]; least: pixels of a group, share of the object's.
    """

    scales: tuple[float, ...] = (30.0, 120.0, 480.0)
    smoothing: float = 1.0
    least: float = 0.004
    name: str = "superpixels"

    def groups_of(self, photograph: Photograph) -> list[np.ndarray]:
        """(H, W) at every scale."""
        solid = photograph.mask >= 0.5
        # what is not of the object has a colour that none of its own can be joined with
        picture = np.where(solid[..., None], _smoothed(photograph.colour, solid, self.smoothing), -3.0)
        least = max(int(self.least * solid.sum()), 4)
        found = []
        for scale in self.scales:
            labels = felzenszwalb(picture, scale=scale, sigma=0, min_size=least, channel_axis=2)
            found.append(_numbered(labels, solid))
        return found


def _smoothed(colour: np.ndarray, solid: np.ndarray, sigma: float) -> np.ndarray:
    """Means (H, W, 3) over the object's pixels nearby alone."""
    weight = solid.astype(np.float64)
    total = cv2.GaussianBlur(colour * weight[..., None], (0, 0), sigma)
    return total / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-6)[..., None]


def _numbered(labels: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """Groups counted from 0 over the object's pixels, -1 beside it."""
    groups = np.full(labels.shape, -1, dtype=np.int32)
    _, number = np.unique(labels[solid], return_inverse=True)
    groups[solid] = number
    return groups
