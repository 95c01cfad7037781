"""Frames lost or repeated: a clock that jumps.

A frame that repeats the one before is seen in the numbers themselves. A lost one is found by scanning: across
a jump of the clock the motion of all markers together is no smooth curve, and becomes one with the frames
that are missing put in. The motion is told by its few singular vectors, smooth by a polynomial over the
frames around.
"""

from __future__ import annotations

import numpy as np

from mphygs.capture.track_faults.scatter import filled_in, motion_basis, scatter
from mphygs.capture.track_faults.tracks import ExaminedTracks, Finding, listed

FAULT = "frame_drops"
# Frames on either side, degree of the curve; fewest frames on a side; most frames that a jump may lose.
AROUND, DEGREE, FEWEST, MOST_LOST = 5, 6, 3, 8
# A jump is one that lowers chi^2 by so much, to at most this share of what was, and leaves no more than so
# many times what is usual, or less than the last share; so many may be found in one recording.
DROP, LEFT, USUAL, CLEARLY, MOST = 60.0, 0.25, 3.0, 0.12, 12
# The next best number of lost frames leaves so much more; and of what chi^2 falls by, all markers but the one
# that gains most have this share: a single one that slips is no clock.
NEXT_BEST, SHARED = 10.0, 0.2
# Where a frame is repeated the later ones are late if that leaves less than this share, by so much at least.
SLIPPED, SLIP = 0.7, 10.0
# Shares of equal coordinates in frames that follow each other: of a repeated one, and of any other.
REPEATED, OTHERS = 0.999, 0.2
# So many repeated frames in a row at most are a fault of the clock.
LONGEST = 6
MARKERS = 2


def repair_frame_drops(tracks: ExaminedTracks) -> ExaminedTracks:
    """The tracks with every frame at its time, what was lost or repeated not measured."""
    position = tracks.position
    frames, count = position.shape[:2]
    if count < MARKERS or frames < 2 * AROUND:
        return tracks
    repeated = _repeated(position)
    kept = np.flatnonzero(~repeated)
    begin = int(np.searchsorted(kept, tracks.release or 0))
    place, lost = kept.astype(int), []
    if len(kept) - begin >= 2 * AROUND:
        place, lost = _placed(position[kept], place, begin, _noise(tracks))
    if not repeated.any() and not lost:
        return tracks
    out = np.full_like(position, np.nan)
    within = place < frames
    out[place[within]] = position[kept[within]]
    said = [f"{n} before frame {int(kept[k])}" for k, n in lost if n > 0]
    words = []
    if said:
        words.append(f"frames are lost: {listed(said)}")
    if repeated.any():
        words.append(f"repeated: {listed([str(k) for k in np.flatnonzero(repeated)], 6)}")
    if any(n for _, n in lost):
        words.append("later ones are put at their times")
    numbers = {"lost": float(sum(n for _, n in lost if n > 0)), "repeated": float(repeated.sum())}
    return tracks.found(Finding(FAULT, "; ".join(words), numbers), position=out)


def _noise(tracks: ExaminedTracks) -> float:
    """[m] of a coordinate: as the tracks show, as stated where they do not."""
    shown = scatter(tracks.position)
    if shown is None or not shown.white.any():
        return tracks.sigma
    return max(shown.typical, 1e-3 * tracks.sigma)


def _repeated(position: np.ndarray) -> np.ndarray:
    """(T,) bool: frames whose every value is that of the frame before, between others that are not so."""
    both = np.isfinite(position[1:]) & np.isfinite(position[:-1])
    number = both.sum(axis=(1, 2))
    with np.errstate(invalid="ignore"):
        equal = ((position[1:] == position[:-1]) & both).sum(axis=(1, 2)) / np.maximum(number, 1)
    same = np.r_[False, (equal >= REPEATED) & (number >= 6)]
    other = np.r_[False, (equal < OTHERS) & (number >= 6)]
    found, frame = np.zeros(len(position), bool), 1
    while frame < len(position):
        if not same[frame]:
            frame += 1
            continue
        stop = frame
        while stop < len(position) and same[stop]:
            stop += 1
        moves = other[max(frame - 2, 0) : frame].any() and (stop == len(position) or other[stop])
        if moves and stop - frame <= LONGEST:
            found[frame:stop] = True
        frame = stop
    return found


def _placed(
    position: np.ndarray, place: np.ndarray, begin: int, sigma: float
) -> tuple[np.ndarray, list[tuple[int, int]]]:
    """Times (T',) of the frames that were kept, in frames, and where how many are lost before one.

    place: where they stand in the file; begin: the first one of the motion; sigma: [m] of a coordinate.
    """
    course = filled_in(position)[begin:].reshape(len(place) - begin, -1)
    usable = np.isfinite(course).all(axis=0)
    marker = np.repeat(np.arange(position.shape[1]), 3)[usable]
    course = course[:, usable] - course[:, usable].mean(axis=0)
    basis = motion_basis(course[:, :, None])[:, 1:]
    if not basis.shape[1]:
        return place, []
    # Amplitudes of orthonormal patterns over the markers carry the noise of a coordinate each.
    amplitudes = course @ np.linalg.svd(course, full_matrices=False)[2][: basis.shape[1]].T
    times = place[begin:].astype(int)
    usual = None
    lost: list[tuple[int, int]] = []
    for _ in range(MOST):
        scores = _scores(amplitudes / sigma, times)
        if not scores:
            break
        if usual is None:
            usual = max(1.0, float(np.median([s[0] / s[2] for s in scores.values()])))
        best = None
        for k, (now, others, degrees) in scores.items():
            (gap, least), (_, next_best) = sorted(others.items(), key=lambda item: item[1])[:2]
            if times[k] - times[k - 1] > 1 and others.get(1, np.inf) < SLIPPED * now - usual * SLIP:
                # Where frames repeat it is only asked whether the later ones are late.
                if best is None or now - others[1] > best[0]:
                    best = (now - others[1], k, 1)
                continue
            clear = gap <= MOST_LOST and next_best - least > NEXT_BEST * usual
            falls = now - least > DROP * usual and least < LEFT * now
            fits = least < max(USUAL * usual * degrees, CLEARLY * now)
            fits = fits and _shared(course, marker, times, k, gap)
            if clear and falls and fits and (best is None or now - least > best[0]):
                best = (now - least, k, gap)
        if best is None:
            break
        _, k, gap = best
        change = gap - int(times[k] - times[k - 1])
        times[k:] += change
        lost.append((begin + k, change))
    return np.r_[place[:begin], times], sorted(lost)


def _scores(
    amplitudes: np.ndarray, times: np.ndarray
) -> dict[int, tuple[float, dict[int, float], float]]:
    """Of every frame k chi^2 of a smooth course across it, that with other gaps before it by the gap, and
    the degrees of freedom. amplitudes: (T, R) in standard deviations; times: (T,) in frames."""
    found = {}
    for k in range(FEWEST, len(times) - FEWEST + 1):
        window = _around(times, k)
        if len(window) < DEGREE + 2:
            continue
        own = int(times[k] - times[k - 1])
        values = {
            gap: float(_unsmooth(amplitudes, times, k, gap, window).sum()) for gap in range(1, MOST_LOST + 2)
        }
        degrees = (len(window) - DEGREE - 1) * amplitudes.shape[1]
        found[k] = (values.pop(own) if own in values else np.inf, values, float(degrees))
    return found


def _around(times: np.ndarray, k: int) -> np.ndarray:
    """Frames about the one before frame k."""
    return np.arange(max(0, k - AROUND), min(len(times), k + AROUND))


def _unsmooth(course: np.ndarray, times: np.ndarray, k: int, gap: int, window: np.ndarray) -> np.ndarray:
    """(C,) sums of squares that smooth curves leave of courses (T, C) with a gap before frame k."""
    own = int(times[k] - times[k - 1])
    t = (times[window] + (window >= k) * (gap - own)).astype(float)
    t = 2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0
    base = np.linalg.qr(np.polynomial.legendre.legvander(t, DEGREE))[0]
    left = course[window] - base @ (base.T @ course[window])
    return (left**2).sum(axis=0)


def _shared(course: np.ndarray, marker: np.ndarray, times: np.ndarray, k: int, gap: int) -> bool:
    """Whether more than one marker is smoother with a gap. course: (T, C); marker: (C,) of every column."""
    window, own = _around(times, k), int(times[k] - times[k - 1])
    gain = _unsmooth(course, times, k, own, window) - _unsmooth(course, times, k, gap, window)
    gain = np.bincount(marker, gain)
    return bool(gain.sum() - gain.max() > SHARED * gain.sum())
