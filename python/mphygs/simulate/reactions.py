"""The reaction at a frame: what the substeps around it say of it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np


def reaction_weights(schedule: Mapping) -> np.ndarray:
    """(n, 2) what each substep counts for in the reactions at the frame before it and at the one after.

    The parabola that fits the substeps of the half intervals to both sides best, at the frame (Savitzky and
    Golay, Analytical Chemistry 36, 1964); at the first and the last frame the line on the side that there
    is. A single substep has the round-off of a constraint that is met in every one of them; its mean has not.
    """
    steps, dt = np.asarray(schedule["steps"], int), np.asarray(schedule["dt"], float)
    begin = np.r_[0, np.cumsum(steps)]
    out = np.zeros((begin[-1], 2))
    for frame in range(len(steps) + 1):
        before = (int(steps[frame - 1]), float(dt[frame - 1])) if frame > 0 else None
        after = (int(steps[frame]), float(dt[frame])) if frame < len(steps) else None
        left, right = _around(before, after)
        out[begin[frame] - len(left) : begin[frame], 1] = left
        out[begin[frame] : begin[frame] + len(right), 0] = right
    return out


@lru_cache(maxsize=64)
def _around(
    before: tuple[int, float] | None, after: tuple[int, float] | None
) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the last substeps before a frame and the first ones after it; each side: substeps of its
    interval and their length [s], None where there is none."""
    left = _middles(*before) if before else np.zeros(0)
    right = _middles(*after) if after else np.zeros(0)
    at = np.r_[-left[::-1], right]
    sides = (before is not None) + (after is not None)
    if not sides:
        return left, right
    lengths = (before[1] if before else 0.0, after[1] if after else 0.0)
    length = np.repeat(lengths, (len(left), len(right)))
    size = np.abs(at).max()
    powers = np.vander(at / size, min(sides + 1, len(at)), increasing=True)
    root = np.sqrt(length / length.mean())
    weights = np.linalg.pinv(powers * root[:, None])[0] * root
    return weights[: len(left)], weights[len(left) :]


def _middles(steps: int, length: float) -> np.ndarray:
    """Distance [s] of the middles of the substeps in half an interval from the frame at its end."""
    return (np.arange((steps + 1) // 2) + 0.5) * length
