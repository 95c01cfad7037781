"""How the noise of tracks grows and falls over the frames, as they show by themselves.

A camera that comes to see less, an object that leaves the middle of the picture: noise whose standard
deviation is another one at the end than at the beginning. Taken for constant, it is too much for the frames
where there is more of it, and what explains a part of that by chance looks like physics.

Each stretch of frames tells its own (see `scatter`), where two independent ways agree: what no motion does
from frame to frame, and what no other marker shares. A motion that begins, or is struck, in some of them is
in one of the two, and those stretches say nothing.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from mphygs.capture.track_faults.scatter import DEEPER, scatter, seen_sigma

# Frames of a stretch, and from one to the next.
STRETCH, APART = 24, 8
# Two ways of telling noise from motion agree within this factor in so short a stretch.
ALIKE = 0.8
# Noise changes where equal noise would do so by chance in one sequence of a million, and by more than this
# factor; stretches that tell are at least so many, and at least this share.
LEVEL, CHANGES, FEWEST, SHARE = 1e-6, 1.25, 3, 0.6
# Stretches that tell how it goes on at either end.
END = 3


def noise_course(position: np.ndarray) -> np.ndarray | None:
    """(T,) the noise's standard deviation over its root mean square over the frames; None where it does not
    change, or where the tracks do not tell.

    position: (T, M, 3) [m], NaN where missing.
    """
    frames = len(position)
    if frames < 2 * STRETCH:
        return None
    begins = np.unique(np.r_[np.arange(0, frames - STRETCH, APART), frames - STRETCH])
    found = np.array([_growth(position[a : a + STRETCH]) for a in begins])
    known = np.isfinite(found[:, 0])
    if known.sum() < FEWEST or known.mean() < SHARE:
        return None
    middle, (logs, own, errors) = begins[known] + 0.5 * (STRETCH - 1), found[known].T
    if not (_changes(begins[known], logs, errors) and _changes(begins[known], own, errors)):
        return None
    # Between the middles of stretches the logarithm is straight; at either end it goes on as it went.
    times = np.arange(frames)
    course = np.interp(times, middle, logs)
    for outside, ends in ((times < middle[0], slice(None, END)), (times > middle[-1], slice(-END, None))):
        course[outside] = np.polyval(np.polyfit(middle[ends], logs[ends], 1), times[outside])
    course = np.exp(course)
    return course / np.sqrt(np.mean(course**2))


def _growth(position: np.ndarray) -> tuple[float, float, float]:
    """Logarithms of the noise of a stretch by either way, and their error; NaN where it does not tell."""
    nothing = (np.nan, np.nan, np.nan)
    seen = seen_sigma(position)
    if seen is None:
        return nothing
    own = scatter(position, DEEPER)
    if own is None or not ALIKE * seen.value < own.typical < seen.value / ALIKE:
        return nothing
    # Variances of numbers with heavy tails differ more.
    error = seen.error * np.sqrt(1.0 + 0.5 * own.kurtosis)
    return float(np.log(seen.value)), float(np.log(own.typical)), float(error)


def _changes(begins: np.ndarray, logs: np.ndarray, errors: np.ndarray) -> bool:
    """Whether stretches that share no frame differ, by more than chance."""
    apart, last = [], -STRETCH
    for k, begin in enumerate(begins):
        if begin - last >= STRETCH:
            apart.append(k)
            last = begin
    if len(apart) < 2 or np.ptp(logs[apart]) < np.log(CHANGES):
        return False
    weights = errors[apart] ** -2.0
    square = (weights * (logs[apart] - np.average(logs[apart], weights=weights)) ** 2).sum()
    return bool(chi2.sf(square, len(apart) - 1) < LEVEL)
