"""Groups of pixels that belong together, at several scales: superpixels, or what a segmenter finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

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
        from skimage.segmentation import felzenszwalb

        solid = photograph.mask >= 0.5
        # what is not of the object has a colour that none of its own can be joined with
        picture = np.where(solid[..., None], photograph.colour, -3.0).astype(np.float64)
        least = max(int(self.least * solid.sum()), 4)
        found = []
        for scale in self.scales:
            labels = felzenszwalb(picture, scale=scale, sigma=self.smoothing, min_size=least, channel_axis=2)
            found.append(_numbered(labels, solid))
        return found


def _numbered(labels: np.ndarray, solid: np.ndarray) -> np.ndarray:
    """Groups counted from 0 over the object's pixels, -1 beside it."""
    groups = np.full(labels.shape, -1, dtype=np.int32)
    _, number = np.unique(labels[solid], return_inverse=True)
    groups[solid] = number
    return groups
