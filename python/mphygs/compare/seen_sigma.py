"""Noise as the tracks themselves show it, whatever was stated: what no motion does from frame to frame.

Differences of order k of independent noise of variance s^2 have the variance (2k over k) s^2; of a motion
they keep less with every order (Gasser, Sroka and Jennen-Steinmetz, Biometrika 73, 1986). Two orders that
agree have nothing of the motion left. Noise that lasts over frames, or a frame's common jitter, is not told
apart here: see `mphygs.compare.rest_noise`.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.stats import chi2

ORDERS = (4, 6)
# Differences that follow each other in a series, and such series, at least; how well two orders agree, in
# standard errors.
IN_A_ROW, SERIES, AGREE = 12, 24, 4.0


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
