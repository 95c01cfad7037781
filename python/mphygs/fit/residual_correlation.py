"""What a residual shows to be common to the markers of a frame, or to last over frames, in the covariance of
the fitted numbers.

Noise that all markers share, and noise that lasts, averages out less than independent noise does: instead of
(J^T J)^-1 the covariance is (J^T J)^-1 J^T R J (J^T J)^-1 (White, Econometrica 48, 1980; Newey & West,
Econometrica 55, 1987). R is pooled over all markers and frames: one number a lag for what a marker has of its
own, one for what all share, and only those that stand out of what independent noise shows by chance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.fit.problem import Evaluation, Problem

# Standard deviations that a correlation has to stand out by, and the longest lag, as a share of the frames.
STANDS_OUT, LONGEST = 4.0, 0.25


@dataclass(frozen=True, eq=False)
class ResidualCorrelation:
    """Covariances of whitened residuals by lag in frames [variance of the noise].

    single: (L,) of one marker with itself beyond what all share, from lag 1 on; common: (L,) of different
    markers, from lag 0 on. Empty where nothing stands out.
    """

    single: tuple[float, ...]
    common: tuple[float, ...]

    @property
    def found(self) -> bool:
        """Whether anything stands out."""
        return bool(self.single or self.common)


def residual_correlation(residual: np.ndarray, observed: np.ndarray) -> ResidualCorrelation:
    """What stands out of a residual (T, M, C), whitened, zero where not observed (T, M)."""
    frames, markers, coordinates = residual.shape
    seen = observed.astype(float)
    square = float((residual**2).sum() / max(coordinates * seen.sum(), 1.0))
    most = int(LONGEST * frames)
    if not square > 0.0 or most < 1:
        return ResidualCorrelation((), ())
    total, count = residual.sum(1), seen.sum(1)
    common: list[float] = []
    pairs = coordinates * float((count**2 - count).sum())
    if markers > 2 and pairs > 0.0:
        shared = float((total**2).sum() - (residual**2).sum()) / pairs
        if shared > STANDS_OUT * square * np.sqrt(2.0 / pairs):
            common.append(shared)
    single: list[float] = []
    still = True
    for lag in range(1, most + 1):
        alike = coordinates * float((seen[lag:] * seen[:-lag]).sum())
        apart = coordinates * float((count[lag:] * count[:-lag]).sum()) - alike
        if alike <= 0.0:
            break
        same = float((residual[lag:] * residual[:-lag]).sum())
        if len(common) == lag and apart > 0.0:
            shared = (float((total[lag:] * total[:-lag]).sum()) - same) / apart
            if shared > STANDS_OUT * common[0] / np.sqrt(coordinates * (frames - lag)):
                common.append(shared)
        beyond = same / alike - (common[lag] if len(common) > lag else 0.0)
        still = still and beyond > STANDS_OUT * square / np.sqrt(alike)
        if still:
            single.append(beyond)
        elif len(common) <= lag:
            break
    return ResidualCorrelation(tuple(single), tuple(common))


def widened_by_correlation(problem: Problem, evaluation: Evaluation, inverse: np.ndarray) -> np.ndarray:
    """(P, P) that what lasts, or is shared, in the residual adds to the covariance; never negative.

    inverse: (P, P) of the normal matrix.
    """
    size = len(inverse)
    middle = np.zeros((size, size))
    for name, rows in evaluation.rows.items():
        whitener = problem.whitener(name)
        shape = (*whitener.observed.shape, whitener.coordinates)
        at = (whitener.frame, whitener.marker, whitener.coordinate)
        residual, slopes = np.zeros(shape), np.zeros((*shape, size))
        residual[at], slopes[at] = evaluation.residual[rows], evaluation.jacobian[rows]
        found = residual_correlation(residual, whitener.observed)
        if not found.found:
            continue
        summed = slopes.sum(1)
        for lag, share in enumerate(found.common):
            part = _products(summed, lag)
            middle += share * (part - _products(slopes, 0) if lag == 0 else part + part.T)
        for lag, share in enumerate(found.single, 1):
            part = _products(slopes, lag)
            middle += share * (part + part.T)
    # In units of the noise's own covariance a direction may gain and not lose.
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    gain, turned = np.linalg.eigh(root.T @ middle @ root)
    along = root @ turned
    return (along * np.maximum(gain, 0.0)) @ along.T


def _products(slopes: np.ndarray, lag: int) -> np.ndarray:
    """(P, P) sum of outer products of slopes (T, ..., P) with those `lag` frames later."""
    size = slopes.shape[-1]
    first = slopes[: len(slopes) - lag].reshape(-1, size)
    return first.T @ slopes[lag:].reshape(-1, size)
