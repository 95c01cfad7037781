"""Gaps written as zeros: a place of exactly 0 0 0 that no marker near it comes to or goes from."""

from __future__ import annotations

import numpy as np

from mphygs.capture.track_faults.tracks import ExaminedTracks, Finding

FAULT = "zero_gaps"
# A place of exactly 0 0 0 is a gap where the marker is so far from there just before and after.
_GAP_SIGMAS, _GAP_SHARE = 20.0, 0.02


def repair_zero_gaps(tracks: ExaminedTracks) -> ExaminedTracks:
    """NaN where a file has zeros for what was not seen.

    Where the capture does not say so, a place of exactly zero is none when the marker is far from there in
    the nearest frames that have another place.
    """
    position, given = tracks.position, tracks.zero_is_missing
    zero = (position == 0.0).all(axis=2)
    if given is None:
        size = float(np.linalg.norm(np.ptp(tracks.at, axis=0)))
        zero &= _distance_nearby(position, zero) > max(_GAP_SIGMAS * tracks.sigma, _GAP_SHARE * size)
    if not zero.any() or given is False:
        return tracks
    count = int(zero.sum())
    text = f"{count} marker positions of exactly 0 0 0 are taken as not measured (zero_is_missing)"
    position = np.where(zero[..., None], np.nan, position)
    return tracks.found(Finding(FAULT, text, {"count": count}), position=position)


def _distance_nearby(position: np.ndarray, zero: np.ndarray) -> np.ndarray:
    """(T, M) [m] from the origin, in the nearest frame in which a marker is seen; endless where in none."""
    frames = np.arange(len(position))
    seen = np.isfinite(position).all(axis=2) & ~zero
    away = np.full(zero.shape, np.inf)
    for marker in np.flatnonzero(zero.any(axis=0) & seen.any(axis=0)):
        known = np.flatnonzero(seen[:, marker])
        right = np.searchsorted(known, frames).clip(0, len(known) - 1)
        left = np.maximum(right - 1, 0)
        distance = np.linalg.norm(position[known, marker], axis=1)
        away[:, marker] = np.minimum(distance[left], distance[right])
    return away
