"""Which pixels show the object: given masks, an alpha channel, or a picture of the background alone."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from mphygs.capture.errors import fault
from mphygs.capture.images import Pixels

_PLATE_DIFFERENCE = 0.08  # of the range of colour, well above the noise of a camera
_ONE = 1.01 / 255
# Shares of a mask's border that shows the object, of the mask that does not, and of all views, from which on
# masks are taken for the wrong way round: an object stands in the middle, or fills a view.
_BORDER, _HOLE, _VIEWS = 0.9, 1e-3, 0.75
_LEAST_SHARE = 1e-5  # of the picture; less is no object


def mask_of_picture(pixels: Pixels) -> np.ndarray:
    """The mask (H, W), 0 to 1, that a picture read from masks/ holds: its brightness, 1 for the object."""
    mask = pixels.colour.max(axis=2)
    brightest = float(mask.max())
    # masks of 0 and 1, which look black
    return mask / brightest if 0.0 < brightest <= _ONE else mask


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


def check_masks(where: str, masks: Sequence[np.ndarray]) -> None:
    """Raises CaptureError where nearly all masks (H, W) show the object all round and not inside, or where no
    mask shows where it ends."""
    inverted = 0
    for mask in masks:
        border = np.concatenate([mask[0], mask[-1], mask[:, 0], mask[:, -1]])
        inverted += (border >= 0.5).mean() > _BORDER and (mask < 0.5).mean() > _HOLE
    if inverted > _VIEWS * len(masks):
        what = f"{inverted} of {len(masks)} masks are white all round and black inside: they look inverted"
        raise fault(where, what, "white where the object is seen")
    if masks and all((mask >= 0.5).all() for mask in masks):
        what = f"all {len(masks)} masks are white all over: nowhere does the object end"
        raise fault(where, what, "white where the object is seen, black elsewhere")
