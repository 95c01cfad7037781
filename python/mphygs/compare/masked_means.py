"""Means over what was measured."""

from __future__ import annotations

import numpy as np


def mean_seen(values: np.ndarray, axis: int | tuple[int, ...]) -> np.ndarray:
    """Mean over one axis, or several, of what is finite; NaN, without a word, where nothing is."""
    finite = np.isfinite(values)
    count = finite.sum(axis)
    total = np.where(finite, values, 0.0).sum(axis)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
