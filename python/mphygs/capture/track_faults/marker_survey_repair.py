"""Markers surveyed wrongly: each is off from its stated place by a constant of its own.

Where the object rests every marker should be at its place. What physics, a wrong unit or a moved frame make
of the resting object is smooth in space; survey errors are not. They are taken for independent normal numbers
of one standard deviation, which what is rough in space tells; each marker's place is then moved to where it
most likely is, and what the few resting frames leave open of it counts as noise that lasts.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2, f

from mphygs.capture.track_faults.lasting_noise import lasting_noise
from mphygs.capture.track_faults.tracks import ExaminedTracks, Finding

FAULT = "marker_survey"
# Fewest markers; from so many on what is smooth is of second order in space, of first below.
MARKERS, SECOND = 10, 30
# Survey errors are there where noise alone would do as much in one capture of a million, of at least this
# share of sigma; what is smooth is theirs where they would do as much in one of a thousand.
LEVEL, LEAST, SMOOTH = 1e-6, 0.3, 1e-3
# Of the standard deviation, that which is told without the worst of the markers, this share of them: else a
# few are off, and not the survey.
TYPICAL, WORST = 0.5, 0.1
# Resting frames that are used where no release is stated.
UNSTATED = 1


def repair_marker_survey(tracks: ExaminedTracks) -> ExaminedTracks:
    """The tracks with places as they rest, where these were surveyed wrongly."""
    if tracks.begins == "measured":
        return tracks
    rest = tracks.position[: tracks.release or UNSTATED]
    seen = np.isfinite(rest).all(axis=(0, 2))
    if seen.sum() < MARKERS:
        return tracks
    own = np.full(len(tracks.at), tracks.sigma) if tracks.scatter is None else tracks.scatter
    # Noise that lasts is much the same in all resting frames: their mean is no less off by it.
    noise = own[seen] * np.sqrt(lasting_noise(tracks.position).of_mean(len(rest)))
    off = rest[:, seen].mean(axis=0) - tracks.at[seen]
    basis = _smooth(tracks.at[seen], second=seen.sum() >= SECOND)
    smooth = basis @ (basis.T @ off)
    rough = off - smooth
    degrees = 3 * (len(off) - basis.shape[1])
    usual = float(np.sqrt(np.mean(noise**2)))
    found = _deviation(tracks.at[seen], off, usual)
    better = np.argsort((rough**2).sum(axis=1))[: len(off) - max(1, int(WORST * len(off)))]
    typical = _deviation(tracks.at[seen][better], off[better], usual)
    ratio = (smooth**2).sum() / (3 * basis.shape[1]) / max((rough**2).sum() / degrees, 1e-300)
    if (
        chi2.sf((rough**2 / noise[:, None] ** 2).sum(), degrees) > LEVEL
        or found < LEAST * tracks.sigma
        or typical < TYPICAL * found
        or f.sf(ratio, 3 * basis.shape[1], degrees) < SMOOTH
    ):
        return tracks
    trust = (found**2 / (found**2 + noise**2))[:, None]
    at = tracks.at.copy()
    at[seen] += trust * off
    left = float(np.sqrt(np.mean(trust * noise[:, None] ** 2)))
    text = (
        f"markers are off from their stated places by {1e3 * found:.3g} mm a coordinate; they are taken to "
        f"be where they rest, to within {1e3 * left:.2g} mm"
    )
    return replace(tracks.found(Finding(FAULT, text, {"sigma": found, "left": left})), at=at, lasting=left)


def _deviation(at: np.ndarray, off: np.ndarray, noise: float) -> float:
    """Standard deviation of survey errors [m]: what is rough of offsets (M, 3) [m], less noise [m]."""
    basis = _smooth(at, second=len(at) >= SECOND)
    rough = off - basis @ (basis.T @ off)
    return float(np.sqrt(max((rough**2).sum() / (3 * (len(off) - basis.shape[1])) - noise**2, 0.0)))


def _smooth(at: np.ndarray, *, second: bool) -> np.ndarray:
    """(M, P) orthonormal fields over places (M, 3) that are polynomials of first or second order."""
    x = (at - at.mean(axis=0)) / np.maximum(np.abs(at - at.mean(axis=0)).max(axis=0), 1e-12)
    columns = [np.ones(len(x)), *x.T]
    if second:
        columns += [x[:, i] * x[:, j] for i in range(3) for j in range(i, 3)]
    vectors, values, _ = np.linalg.svd(np.stack(columns, axis=1), full_matrices=False)
    return vectors[:, values > 1e-9 * values[0]]
