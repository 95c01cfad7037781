"""Bad tracks: markers whose misfit jumps against that of their neighbours, which no physics does."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

NEIGHBOURS = 6
# Deviations from the neighbours beyond this many sigma (per coordinate) are not noise.
LIMIT = 8.0
# A marker that deviates in this share of its frames is left out whole.
WHOLE = 0.2
# A track that is lost deviates by more than this share of its neighbours' own misfit; a single wrong
# measurement jumps by this share of its deviation.
STANDS_OUT, JUMP = 0.7, 0.6
# ... and is this many times as large as its neighbours' misfit: a fast motion that is missed jumps as well.
WELL_ABOVE = 3.0
# More than this share of all markers is no longer a matter of single tracks.
LARGEST_SHARE = 0.2
SMALLEST_SHARE = 0.002


def bad_observations(residual: np.ndarray, at: np.ndarray, sigma: float) -> np.ndarray:
    """(T, M) bool: measurements that do not belong to the surface that their neighbours follow.

    residual: (T, M, 3) measured - predicted [m], NaN where missing; at: (M, 3) rest positions [m];
    sigma: of a coordinate [m]. A missing effect moves neighbours alike, a bad track moves one point.
    Empty (all False) for fewer than NEIGHBOURS + 1 markers.
    """
    frames, markers = residual.shape[:2]
    bad = np.zeros((frames, markers), bool)
    if markers <= NEIGHBOURS:
        return bad
    _, near = cKDTree(at).query(at, k=NEIGHBOURS + 1)
    around = residual[:, near[:, 1:]]  # (T, M, k, 3)
    seen = np.isfinite(around).all(-1).sum(-1) >= 3
    around = np.where(seen[..., None, None], around, 0.0)
    middle = np.nanmedian(around, axis=2)
    spread = np.nanmedian(np.abs(around - middle[:, :, None]), axis=2).max(-1) * 1.4826
    gap = np.nan_to_num(np.abs(residual - middle).max(-1))
    bad = seen & (gap > LIMIT * sigma) & (gap > 5.0 * np.maximum(spread, sigma))
    # Where all around is far off as well, a missing effect may bend the field this much: a lost track stands
    # out of it.
    level = np.nan_to_num(np.abs(middle).max(-1))
    often = (bad & (gap > STANDS_OUT * level)).mean(0) > WHOLE
    # A single wrong measurement is a jump in time too; a misfit of the physics is not.
    bad &= (_jumps(residual) > JUMP * gap) & (gap > WELL_ABOVE * level)
    bad[:, often] = True
    # A handful of points beside a wall, say, is physics; a broken tracker breaks more often.
    few = bad.mean() < SMALLEST_SHARE and not often.any()
    if few or often.mean() > LARGEST_SHARE or bad.mean() > LARGEST_SHARE:
        return np.zeros((frames, markers), bool)
    return bad


def _jumps(residual: np.ndarray) -> np.ndarray:
    """(T, M) largest coordinate of the difference from the mean of the frames before and after [m]."""
    padded = np.concatenate([residual[:1], residual, residual[-1:]])
    with np.errstate(invalid="ignore"):
        pair = np.stack([padded[:-2], padded[2:]])
        count = np.isfinite(pair).sum(0)
        middle = np.where(count > 0, np.nan_to_num(pair).sum(0) / np.maximum(count, 1), np.nan)
    return np.nan_to_num(np.abs(residual - middle).max(-1))
