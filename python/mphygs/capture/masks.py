"""Which pixels show the object: given masks, an alpha channel, or a picture of the background alone."""

from __future__ import annotations

import cv2
import numpy as np

from mphygs.capture.errors import fault
from mphygs.capture.images import Pixels

_PLATE_DIFFERENCE = 0.08  # of the range of colour, well above the noise of a camera
_LEAST_SHARE = 1e-5  # of the picture; less is no object


def mask_of_picture(pixels: Pixels) -> np.ndarray:
    """The mask (H, W), 0 to 1, that a picture read from masks/ holds: its brightness, 1 for the object."""
    return pixels.colour.max(axis=2)


def mask_of_plate(
    colour: np.ndarray, plate: np.ndarray, *, difference: float = _PLATE_DIFFERENCE
) -> np.ndarray:
    """The mask (H, W), 0 or 1, of the pixels whose colour is not the background's.

    colour, plate: (H, W, 3), 0 to 1, of one camera that did not move; difference: largest over the channels
    from which a pixel counts as object, after a median over 3 x 3 pixels against noise. Specks and holes
    of one or two pixels are closed.
    """
    away = cv2.medianBlur(np.abs(colour - plate).max(axis=2).astype(np.float32), 3)
    mask = (away > difference).astype(np.uint8)
    kernel = np.ones((3, 3), np.uint8)
    mask = cv2.morphologyEx(cv2.morphologyEx(mask, cv2.MORPH_OPEN, kernel), cv2.MORPH_CLOSE, kernel)
    return mask.astype(np.float32)


def checked_mask(mask: np.ndarray, where: str) -> np.ndarray:
    """`mask` (H, W) unless it is empty, for which CaptureError is raised."""
    if (mask >= 0.5).mean() < _LEAST_SHARE:
        raise fault(where, "the mask is empty", "white where the object is seen")
    return mask
