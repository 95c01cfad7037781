"""The noise that tracks show by themselves, whatever was stated of it: all of it, or each marker's own.

Two ways, for two questions. `seen_sigma` tells what no motion does from frame to frame, a frame's common
jitter included: differences of order k of independent noise of variance s^2 have the variance
(2k over k) s^2, and of a motion they keep less with every order (Gasser, Sroka and Jennen-Steinmetz,
Biometrika 73, 1986); two orders that agree have nothing of the motion left.

`scatter` tells what neither the other markers do nor a slow motion, marker by marker. A body moves in few
ways at once: the singular vectors over time of the other markers hold its motion. What they leave of a marker
is its noise, and its third differences, which a slow rest of motion hardly has, tell how large that is (noise
beside a low rank: Gavish and Donoho, IEEE Transactions on Information Theory 60, 2014).

How noise hangs together, over frames or between markers, is shown by points that cannot move alone: see
`mphygs.compare.rest_noise`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.stats import chi2

ORDER = 3
# Fewest frames and markers that tell noise from motion; longest stretch of frames that is seen at once.
FRAMES, MARKERS, STRETCH = 12, 6, 120
# Parts that markers are dealt to: each one's motion is told by the others.
GROUPS = 4
# The motion's share of the frames at most, one in so many. Beside the ways to move that stand out of the
# noise as many again hardly do: they are taken off with them where noise is to be told from motion.
DEEPEST, DEEPER = 3, 2
# A marker seen less often than this tells nothing.
SEEN = 0.6
# Orders of differences that are compared; differences that follow each other in a series, and such series, at
# least; how well two orders agree, in standard errors.
ORDERS, IN_A_ROW, SERIES, AGREE = (4, 6), 12, 24, 4.0


@dataclass(frozen=True, eq=False)
class Scatter:
    """sigma: (M,) [m] noise of a coordinate, NaN where not known; degrees: (M,) degrees of freedom behind it;
    whole: (M,) [m] all that the others leave; kurtosis: of what they leave, beyond a normal number's."""

    sigma: np.ndarray
    degrees: np.ndarray
    whole: np.ndarray
    kurtosis: float

    @property
    def least(self) -> np.ndarray:
        """(M,) [m] noise at most: a fast rest of motion has larger differences than noise has, and neither
        sum is less than noise makes."""
        return np.minimum(self.sigma, self.whole)

    @property
    def typical(self) -> float:
        """[m] that of markers of which it is known, zero where there are none."""
        return float(np.median(self.sigma[self.white])) if self.white.any() else 0.0

    @property
    def white(self) -> np.ndarray:
        """(M,) bool: known, and all that the others leave is new in every frame."""
        with np.errstate(invalid="ignore"):
            return np.isfinite(self.sigma) & (self.sigma > 0.0) & (self.whole < np.sqrt(2.0) * self.sigma)


@dataclass(frozen=True)
class SeenSigma:
    """value: standard deviation of one coordinate [m]; error: of it, relative."""

    value: float
    error: float

    @property
    def degrees(self) -> float:
        """Degrees of freedom that a variance is known by as well."""
        return 0.5 / self.error**2

    def differs(self, stated: float) -> bool:
        """Whether it is another one than was stated."""
        return bool(abs(np.log(self.value / stated)) > AGREE * self.error)


def seen_sigma(position: np.ndarray) -> SeenSigma | None:
    """The noise of tracks (T, M, 3) [m], NaN where missing; None where too few follow each other, or where
    motion is left in the differences.

    The median over series, each of a coordinate of a marker, tells it: a few that jump are not the noise of
    the others.
    """
    found, error = [], 0.0
    for order in ORDERS:
        differences = np.diff(position, n=order, axis=0)
        seen = np.isfinite(differences)
        count = seen.sum(0)
        enough = count >= IN_A_ROW
        if enough.sum() < SERIES:
            return None
        gain = comb(2 * order, order)
        squares = np.where(seen, differences, 0.0)[:, enough] ** 2
        # Differences that share frames are worth fewer independent ones.
        degrees = count[enough] * gain**2 / comb(4 * order, 2 * order)
        variance = squares.sum(0) / (gain * count[enough]) * degrees / chi2.median(degrees)
        found.append(float(np.sqrt(np.median(variance))))
        error = 0.5 * np.sqrt(0.5 * np.pi * 2.0 / np.median(degrees) / enough.sum())
    before, after = differences[:-1], differences[1:]
    both = np.isfinite(before) & np.isfinite(after)
    before, after = before[both], after[both]
    together = before @ after / max(np.sqrt(before @ before * (after @ after)), np.finfo(float).tiny)
    # Of independent noise they are opposed; a shock, which leaves as much in both orders, is less so.
    if together > -ORDERS[-1] / (ORDERS[-1] + 1) + AGREE * error:
        return None
    if not found[-1] > 0.0 or abs(found[0] - found[-1]) > AGREE * error * found[-1]:
        return None
    return SeenSigma(found[-1], float(error))


def own_noise(position: np.ndarray) -> float:
    """Noise that no marker of tracks (T, M, 3) shares with others [m], zero where they do not tell."""
    shown = scatter(position, DEEPER)
    return 0.0 if shown is None else shown.typical


def scatter(position: np.ndarray, times: int = 1) -> Scatter | None:
    """Of tracks (T, M, 3) [m], NaN where not measured; None where they are too few or too short.

    times: as many ways to move are taken off as stand out of the noise; more than one, and None also where
    these are too many to leave noise alone.
    """
    frames, count = position.shape[:2]
    seen = np.isfinite(position).all(axis=2)
    used = np.flatnonzero(seen.mean(axis=0) >= SEEN)
    if frames < FRAMES or len(used) < MARKERS:
        return None
    filled = filled_in(position[:, used])
    blocks = max(1, round(frames / STRETCH))
    edges = np.linspace(0, frames, blocks + 1).astype(int)
    sums = np.zeros((5, len(used)))
    moments = np.zeros(3)
    for first, last in zip(edges[:-1], edges[1:], strict=True):
        for group in range(min(GROUPS, len(used))):
            mine = np.arange(group, len(used), min(GROUPS, len(used)))
            others = np.setdiff1d(np.arange(len(used)), mine)
            course = filled[first:last]
            if times > 1 and crowded(course[:, others]):
                return None
            basis = motion_basis(course[:, others], times)
            own, moment = _left(course[:, mine], seen[first:last, used[mine]], basis)
            # The others' own noise is in the ways that they move in: each of these leaves of a motion as much
            # as the noise of one coordinate, spread over all of theirs (errors in variables).
            own[[1, 4]] *= 1.0 + ways_of(course[:, others]) / (3.0 * len(others))
            sums[:, mine] += own
            moments += moment
    out = np.full((3, count), np.nan)
    with np.errstate(invalid="ignore", divide="ignore"):
        out[1, used] = sums[2]
        out[2, used] = np.sqrt(sums[3] / sums[4])
        out[0, used] = np.sqrt(sums[0] / sums[1])
    kurtosis = float(max(moments[1] * moments[2] / max(moments[0] ** 2, 1e-300) - 3.0, 0.0))
    return Scatter(out[0], out[1], out[2], kurtosis)


def filled_in(position: np.ndarray) -> np.ndarray:
    """Tracks with their gaps filled by straight lines."""
    seen = np.isfinite(position).all(axis=2)
    filled, times = position.copy(), np.arange(len(position))
    for marker in np.flatnonzero(~seen.all(axis=0) & seen.any(axis=0)):
        known = np.flatnonzero(seen[:, marker])
        for c in range(3):
            filled[:, marker, c] = np.interp(times, known, position[known, marker, c])
    return filled


def motion_basis(course: np.ndarray, times: int = 1) -> np.ndarray:
    """(T, R + 1) orthonormal courses over time that hold the motion of tracks (T, M, 3), a constant among
    them: singular values above the optimal threshold for unknown noise, so many times as many."""
    frames = len(course)
    matrix = course.reshape(frames, -1)
    matrix = matrix - matrix.mean(axis=0)
    vectors, values, _ = np.linalg.svd(matrix, full_matrices=False)
    rank = min(_rank(values, matrix.shape), frames // DEEPEST)
    rank = min(times * rank, frames // 2)
    return np.hstack([np.full((frames, 1), frames**-0.5), vectors[:, :rank]])


def ways_of(course: np.ndarray) -> int:
    """In how many ways tracks (T, M, 3) move, as far as these stand out of the noise."""
    matrix = course.reshape(len(course), -1)
    return _rank(np.linalg.svd(matrix - matrix.mean(axis=0), compute_uv=False), matrix.shape)


def crowded(course: np.ndarray) -> bool:
    """Whether tracks (T, M, 3) move in so many ways that a third of the frames, or of the coordinates, do not
    hold them: what is left then has motion in it, and does not tell noise."""
    return ways_of(course) >= min(len(course), 3 * course.shape[1]) // DEEPEST


def _rank(values: np.ndarray, shape: tuple[int, int]) -> int:
    """How many singular values of a matrix stand out of noise of unknown size."""
    ratio = min(shape) / max(shape)
    threshold = 0.56 * ratio**3 - 0.95 * ratio**2 + 1.82 * ratio + 1.43
    return int((values > threshold * np.median(values)).sum())


def _left(course: np.ndarray, measured: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of some markers: squares of third differences, what unit noise would have of them, their degrees of
    freedom, squares of all that is left and what unit noise would have of those, (5, M); and sums for the
    kurtosis of what is left: of squares, of fourth powers and how many."""
    frames = len(course)
    projector = np.eye(frames) - basis @ basis.T
    difference = np.diff(np.eye(frames), n=ORDER, axis=0) @ projector
    left = np.tensordot(projector, course, axes=1)
    rough = np.tensordot(difference, course, axes=1)
    run = np.lib.stride_tricks.sliding_window_view(measured, ORDER + 1, axis=0).all(axis=-1)
    norms, own = (difference**2).sum(axis=1), np.diag(projector)
    # Differences that follow each other hang together: so many are worth one.
    worth = float((norms.sum()) ** 2 / ((difference @ difference.T) ** 2).sum()) / len(norms)
    sums = np.stack(
        [
            (np.where(run[..., None], rough, 0.0) ** 2).sum(axis=(0, 2)),
            3.0 * (run * norms[:, None]).sum(axis=0),
            3.0 * worth * run.sum(axis=0),
            (np.where(measured[..., None], left, 0.0) ** 2).sum(axis=(0, 2)),
            3.0 * (measured * own[:, None]).sum(axis=0),
        ]
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        unit = left / np.sqrt(sums[3] / sums[4])[:, None]
    unit = np.where(measured[..., None] & np.isfinite(unit), unit, 0.0)
    return sums, np.array([(unit**2).sum(), (unit**4).sum(), 3.0 * measured.sum()])
