"""Noise that the misfit itself shows: what jumps from frame to frame, as no slow motion does.

The third differences of independent noise of variance s^2 have the variance 20 s^2; of an oscillation at an
eighth of the frame rate or slower they keep, over 20, a hundredth of the mean square and less (estimates of
variance by differences: Gasser, Sroka and Jennen-Steinmetz, "Residual variance and residual pattern in
nonlinear regression", Biometrika 73, 1986). Of a faster one they keep more, but two that follow each other
are less opposed: their correlation is cos(2 pi f / fps), that of noise is -3/4. Beyond a third of the frame
rate nothing tells the two apart. It is no noise model: whitening by the misfit would hide what is missing. It
only says that a stated sigma is too small.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mphygs.compare.assess import Compared

ORDER, GAIN = 3, 20.0
# A sigma is doubted where jumps say so many times as much and are most of the misfit's mean square.
TOO_SMALL, MOST = 1.4, 0.6
# Differences that follow each other are at least so opposed, in the mean over all markers.
OPPOSED = -0.65
# Differences that a marker is judged by, at least.
ENOUGH = 8


def jumps(misfit: np.ndarray) -> float:
    """Standard deviation of one coordinate by what jumps from frame to frame, the median over markers.

    misfit: (T, M, 3) [m], measured - predicted, NaN where missing. Returns metres; 0 where too little was
    measured in a row.
    """
    differences = np.diff(misfit, n=ORDER, axis=0)
    seen = np.isfinite(differences).all(2)
    enough = seen.sum(0) >= ENOUGH
    if not enough.any():
        return 0.0
    squares = np.where(seen[..., None], differences, 0.0)[:, enough] ** 2
    variance = squares.sum((0, 2)) / (3.0 * GAIN * seen.sum(0)[enough])
    return float(np.sqrt(np.median(variance)))


def opposed(misfit: np.ndarray) -> float:
    """Correlation of third differences that follow each other, over all markers; 0 where there are none.

    misfit: (T, M, 3) [m], measured - predicted, NaN where missing.
    """
    differences = np.diff(misfit, n=ORDER, axis=0)
    before, after = differences[:-1], differences[1:]
    both = np.isfinite(before) & np.isfinite(after)
    before, after = before[both], after[both]
    return float(before @ after / max(np.sqrt(before @ before * (after @ after)), 1e-300))


def doubted_sigma(compared: Mapping[str, Compared]) -> list[str]:
    """One line for every sequence whose misfit is mostly noise that is larger than its sigma."""
    lines = []
    for name, item in compared.items():
        window = slice(*item.frames)
        misfit = np.where(
            item.observation.observed[window][..., None],
            item.observation.position[window] - item.predicted[window],
            np.nan,
        )
        if not np.isfinite(misfit).any():
            continue
        noise, sigma, rms = jumps(misfit), item.observation.sigma, float(np.sqrt(np.nanmean(misfit**2)))
        if noise > TOO_SMALL * sigma and noise**2 > MOST * rms**2 and opposed(misfit) < OPPOSED:
            lines.append(
                f"'{name}': most of the misfit jumps from frame to frame, as noise of {1e3 * noise:.2g} mm a "
                f"coordinate does; sigma ({1e3 * sigma:.2g} mm: {item.observation.noise.source}) may be "
                f"{noise / sigma:.2g} times too small"
            )
    return lines
