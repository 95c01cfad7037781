"""What footage of points that cannot move says about the noise: its scale, correlation and common jitter.

Each coordinate of each marker is an unknown constant plus AR(p) noise. The constants are integrated out
(restricted likelihood), so a short series is not mistaken for a less correlated one, and the scale of every
marker is profiled; the coefficients are shared by all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import chi2

from mphygs.compare.autoregression import Array, Autoregression, GapWhitener

MAXIMUM_ORDER = 3
# Correlation is believed only when it beats white noise at this level, whatever Akaike's criterion says.
CORRELATION_LEVEL = 0.01
# One-sided normal quantile the mean correlation between markers must pass to be called a common jitter.
COMMON_QUANTILE = 4.0


@dataclass(frozen=True)
class RestFit:
    """Noise of points at rest.

    process: autoregression of unit variance shared by the markers.
    variance: (M,) [m^2] of one coordinate of each marker.
    degrees: (M,) degrees of freedom behind each variance.
    p_value: of white noise against `process`; 1 when white was chosen.
    """

    process: Autoregression
    variance: Array
    degrees: Array
    p_value: float


@dataclass(frozen=True)
class CommonFit:
    """Jitter shared by all markers of a frame.

    process: its autoregression. variance: (C,) [m^2] per coordinate. z_score: of its presence.
    """

    process: Autoregression
    variance: Array
    z_score: float


def _restricted(
    process: Autoregression, series: Array, observed: NDArray[np.bool_]
) -> tuple[float, Array, Array, Array]:
    """Restricted log-likelihood, variances (M,), degrees of freedom (M,), whitened residuals (T, M, C)."""
    count = series.shape[1]
    whitener = GapWhitener(process, np.ones(count), np.zeros(count), observed)
    values = whitener.whiten(np.where(observed[..., None], series, 0.0))
    constant = whitener.whiten(np.ones((*observed.shape, 1)))
    weight = (constant**2).sum(0)
    residual = values - constant * ((constant * values).sum(0) / weight)
    coordinates = series.shape[2]
    degrees = coordinates * (observed.sum(0) - 1.0)
    squares = (residual**2).sum((0, 2))
    variance = squares / degrees
    if np.any(variance <= 0.0):
        raise ValueError(f"marker {int(np.argmin(variance))} at rest does not scatter at all: expected data")
    likelihood = -0.5 * (
        degrees * np.log(variance) + coordinates * (2.0 * whitener.log_determinant + np.log(weight[:, 0]))
    )
    return float(likelihood.sum()), variance, degrees, residual


def fit_rest(series: Array, observed: NDArray[np.bool_], *, maximum_order: int = MAXIMUM_ORDER) -> RestFit:
    """Autoregression of the order Akaike's criterion picks, white unless the data reject white.

    series: (T, M, C) [m]; observed: (T, M), at least two frames per marker.
    """
    if np.any(observed.sum(0) < 2):
        raise ValueError(
            f"marker {int(np.argmin(observed.sum(0)))} at rest: expected it in at least two frames"
        )
    white, variance, degrees, _ = _restricted(Autoregression(), series, observed)
    best = RestFit(Autoregression(), variance, degrees, 1.0)
    best_criterion = -2.0 * white
    start = np.zeros(0)
    for order in range(1, maximum_order + 1):
        found = minimize(
            lambda x: -_restricted(Autoregression.from_partial(np.tanh(x)), series, observed)[0],
            np.append(start, 0.0),
            method="L-BFGS-B",
            bounds=[(-4.0, 4.0)] * order,
        )
        start = found.x
        criterion = 2.0 * float(found.fun) + 2.0 * order
        p_value = float(chi2.sf(2.0 * (-float(found.fun) - white), order))
        if criterion < best_criterion and p_value < CORRELATION_LEVEL:
            process = Autoregression.from_partial(np.tanh(found.x))
            _, variance, degrees, _ = _restricted(process, series, observed)
            best, best_criterion = RestFit(process, variance, degrees, p_value), criterion
    return best


def fit_common(series: Array, observed: NDArray[np.bool_], fit: RestFit) -> CommonFit | None:
    """Jitter shared by the markers of a frame, or None unless it is clearly there (and at least 3 markers).

    Tested on the mean product of different markers' whitened series, which is zero without common jitter;
    every marker weighs by the inverse of its own scatter, so that one bad marker cannot make or hide it.
    """
    count = series.shape[1]
    if count < 3:
        return None
    _, variance, _, residual = _restricted(fit.process, series, observed)
    unit = residual / np.sqrt(variance)[:, None]
    # Sum over pairs = half of (square of the sum minus the sum of squares).
    pairs = 0.5 * (unit.sum(1) ** 2 - (unit**2).sum(1))
    seen = observed.sum(1)
    pair_count = 0.5 * seen * (seen - 1.0)
    z_score = float(pairs.sum() / np.sqrt(series.shape[2] * pair_count.sum()))
    if z_score < COMMON_QUANTILE:
        return None
    centred = np.where(observed[..., None], series - _means(series, observed), 0.0)
    scale = 1.0 / np.sqrt(variance)
    weighted = centred * scale[:, None]
    weights = np.where(observed, scale, 0.0)
    products = (weighted.sum(1) ** 2 - (weighted**2).sum(1)).sum(0)
    common = products / (weights.sum(1) ** 2 - (weights**2).sum(1)).sum()
    # What all markers share cannot exceed the scatter of the quietest.
    common = np.clip(common, 0.0, 0.9 * variance.min())
    mean = weighted.sum(1) / np.maximum(weights.sum(1), np.finfo(float).tiny)[:, None]
    present = seen > 0
    process = fit_rest(mean[:, None, :], present[:, None]).process
    return CommonFit(process, common, z_score)


def without_common(series: Array, observed: NDArray[np.bool_]) -> Array:
    """(T, M, C) deviations from the mean of the markers seen in each frame, scaled to keep the variance."""
    seen = observed.sum(1)[:, None, None]
    masked = np.where(observed[..., None], series - _means(series, observed), 0.0)
    mean = masked.sum(1, keepdims=True) / np.maximum(seen, 1)
    return (masked - mean) * np.sqrt(seen / np.maximum(seen - 1.0, 1.0))


def _means(series: Array, observed: NDArray[np.bool_]) -> Array:
    filled = np.where(observed[..., None], series, 0.0)
    return filled.sum(0) / np.maximum(observed.sum(0), 1)[:, None]
