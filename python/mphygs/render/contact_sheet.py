"""Small pictures side by side on one sheet, with captions: what a person looks at after a stage."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

_GAP, _CAPTION = 6, 22  # [px]
_PAPER, _INK = 0.97, 40
_FONT = cv2.FONT_HERSHEY_SIMPLEX


def contact_sheet(
    rows: Sequence[Sequence[np.ndarray]], captions: Sequence[Sequence[str]], *, width: int = 256
) -> np.ndarray:
    """Pictures (H, W, 3), 0 to 1, each brought to `width` [px], in rows with a caption above each; (H, W, 3).

    Raises ValueError where rows and captions are not of one shape.
    """
    if [len(row) for row in rows] != [len(row) for row in captions] or not rows:
        raise ValueError("captions: are not one for each picture; expected rows of the same lengths")
    strips = []
    for pictures, words in zip(rows, captions, strict=True):
        sized = [_sized(picture, width) for picture in pictures]
        height = max(picture.shape[0] for picture in sized)
        cells = [_cell(picture, text, height) for picture, text in zip(sized, words, strict=True)]
        strips.append(np.concatenate(cells, axis=1))
    across = max(strip.shape[1] for strip in strips)
    padded = [np.pad(s, ((0, 0), (0, across - s.shape[1]), (0, 0)), constant_values=_PAPER) for s in strips]
    return np.concatenate(padded, axis=0)


def _sized(picture: np.ndarray, width: int) -> np.ndarray:
    height = max(round(picture.shape[0] * width / picture.shape[1]), 1)
    way = cv2.INTER_AREA if picture.shape[1] > width else cv2.INTER_NEAREST
    return cv2.resize(np.clip(picture, 0, 1).astype(np.float32), (width, height), interpolation=way)


def _cell(picture: np.ndarray, text: str, height: int) -> np.ndarray:
    width = picture.shape[1]
    cell = np.full((height + _CAPTION + _GAP, width + _GAP, 3), round(255 * _PAPER), dtype=np.uint8)
    cell[_CAPTION : _CAPTION + picture.shape[0], :width] = np.round(255 * picture)
    cv2.putText(cell, text, (3, 15), _FONT, 0.4, (_INK, _INK, _INK), 1, cv2.LINE_AA)
    return cell.astype(np.float32) / 255
