"""How much of the noise of tracks lasts over frames, as they show by themselves.

What the other markers' motion leaves of a marker (see `scatter`) has lost whatever of a slow noise looks like
that motion, and its mean: it hangs together over frames less than the noise does. So the noise is taken for a
white one and one that is carried on from frame to frame, and the covariances over lags that these would leave
behind the same projection are held against those that are there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import toeplitz
from scipy.optimize import nnls

from mphygs.capture.track_faults.scatter import (
    FRAMES,
    GROUPS,
    MARKERS,
    SEEN,
    STRETCH,
    crowded,
    filled_in,
    motion_basis,
)

# What of it is carried from frame to frame, as it is tried; lags that are held against each other.
CARRIED, LAGS = (0.5, 0.7, 0.8, 0.9, 0.95, 0.98), 8


@dataclass(frozen=True)
class Lasting:
    """share: of the variance that lasts; carried: of it from one frame to the next."""

    share: float = 0.0
    carried: float = 0.0

    def of_mean(self, frames: int) -> float:
        """Variance of the mean of so many frames in a row, over that of one."""
        together = toeplitz(self.carried ** np.arange(frames)).mean()
        return float((1.0 - self.share) / frames + self.share * together)


def lasting_noise(position: np.ndarray) -> Lasting:
    """Of the first frames of tracks (T, M, 3) [m], NaN where not measured; nothing where they do not tell."""
    seen = np.isfinite(position).all(axis=2)
    used = np.flatnonzero(seen.mean(axis=0) >= SEEN)
    if len(position) < FRAMES or len(used) < MARKERS:
        return Lasting()
    course = filled_in(position[:, used])[:STRETCH]
    lags = min(LAGS, len(course) // 3)
    groups = min(GROUPS, len(used))
    there, white = np.zeros(lags), np.zeros(lags)
    lasts = np.zeros((len(CARRIED), lags))
    for group in range(groups):
        mine = np.arange(group, len(used), groups)
        others = course[:, np.setdiff1d(np.arange(len(used)), mine)]
        if crowded(others):
            return Lasting()
        basis = motion_basis(others)
        projector = np.eye(len(course)) - basis @ basis.T
        left = np.tensordot(projector, course[:, mine], axes=1).reshape(len(course), -1)
        there += _by_lag(left @ left.T, lags)
        white += left.shape[1] * _by_lag(projector, lags)
        for k, carried in enumerate(CARRIED):
            covariance = projector @ toeplitz(carried ** np.arange(len(course))) @ projector
            lasts[k] += left.shape[1] * _by_lag(covariance, lags)
    fits = [nnls(np.stack([white, one], axis=1), there) for one in lasts]
    best = int(np.argmin([residual for _, residual in fits]))
    new, lasting = fits[best][0]
    return Lasting(float(lasting / (new + lasting)), CARRIED[best]) if lasting > 0.0 else Lasting()


def _by_lag(covariance: np.ndarray, lags: int) -> np.ndarray:
    """(L,) sums over pairs of frames that are 0, 1, ... apart."""
    return np.array([np.trace(covariance, offset=lag) for lag in range(lags)])
