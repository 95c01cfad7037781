"""The reaction at a frame: what the substeps around it say of it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from mphygs.simulate.timeline import FIRST_OF_PAIR


def reaction_weights(schedule: Mapping) -> np.ndarray:
    """(n, 2) what each substep counts for in the reactions at the frame before it and at the one after.

    The parabola that fits the substeps of the half intervals to both sides best, at the frame (Savitzky and
    Golay, Analytical Chemistry 36, 1964); at the first and the last frame the line on the side that there
    is. A single substep has the round-off of a constraint that is met in every one of them; its mean has not.
    """
    steps, dt = np.asarray(schedule["steps"], int), np.asarray(schedule["dt"], float)
    paired = bool(schedule.get("paired"))
    begin = np.r_[0, np.cumsum(steps)]
    out = np.zeros((begin[-1], 2))
    for frame in range(len(steps) + 1):
        before = (int(steps[frame - 1]), float(dt[frame - 1])) if frame > 0 else None
        after = (int(steps[frame]), float(dt[frame])) if frame < len(steps) else None
        left, right = _around(before, after, paired)
        out[begin[frame] - len(left) : begin[frame], 1] = left
        out[begin[frame] : begin[frame] + len(right), 0] = right
    return out


@lru_cache(maxsize=64)
def _around(
    before: tuple[int, float] | None, after: tuple[int, float] | None, paired: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the last substeps before a frame and the first ones after it; each side: substeps of its
    interval and their length [s], None where there is none."""
    sides = (before is not None) + (after is not None)
    left, right = _near(before, paired, last=True), _near(after, paired, last=False)
    at, length = np.concatenate([left, right], axis=1)
    if not sides:
        return at, at
    size = np.abs(at).max()
    powers = np.vander(at / size, min(sides + 1, len(at)), increasing=True)
    root = np.sqrt(length / length.mean())
    weights = np.linalg.pinv(powers * root[:, None])[0] * root
    return weights[: left.shape[1]], weights[left.shape[1] :]


def _near(interval: tuple[int, float] | None, paired: bool, *, last: bool) -> np.ndarray:
    """(2, n) when the substeps of the half of an interval that is next to a frame ask for forces, from the
    frame [s], and how long each counts [s]; last: whether the frame is at the interval's end."""
    if interval is None:
        return np.zeros((2, 0))
    steps, length = interval
    asked = np.stack(_asked(steps, length, paired))
    count = (steps + 1) // 2
    count += count % 2 if paired else 0
    if not last:
        return asked[:, :count]
    return asked[:, steps - count :] - [[steps * length], [0.0]]


def _asked(steps: int, length: float, paired: bool) -> tuple[np.ndarray, np.ndarray]:
    """When an interval's substeps ask for forces, from its start [s], and how long each counts [s]: in the
    middle for its own length; of pairs the first in its middle, the second at its end, as the momentum that
    a pair gives has them."""
    if not paired:
        return (np.arange(steps) + 0.5) * length, np.full(steps, length)
    pair = 2.0 * length
    late = 0.5 * FIRST_OF_PAIR
    begin = np.repeat(pair * np.arange(steps // 2), 2)
    return begin + pair * np.tile([late, 1.0], steps // 2), pair * np.tile([1.0 - late, late], steps // 2)
