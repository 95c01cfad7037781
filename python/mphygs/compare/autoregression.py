"""Autoregressive noise over frames, whitened exactly with gaps.

The whitener is the Kalman filter of an AR(p) process observed with optional white noise: its innovations over
their standard deviations are L^-1 x, L the Cholesky factor of the covariance of the *observed* frames
(Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, section 3.4). A missing frame
is a prediction without an update, so no gap is ever filled in.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import solve_discrete_lyapunov

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Autoregression:
    """A stationary AR(p) process of unit variance: x_t = sum_i coefficients[i] x_{t-1-i} + innovation.

    `coefficients` may be empty (white noise). Raises ValueError when the process is not stationary.
    """

    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.order and np.abs(np.linalg.eigvals(self.transition)).max() >= 1.0 - 1e-9:
            raise ValueError(f"AR coefficients {self.coefficients}: expected a stationary process")

    @property
    def order(self) -> int:
        """Number of coefficients, p."""
        return len(self.coefficients)

    @property
    def transition(self) -> Array:
        """(p, p) companion matrix."""
        matrix = np.eye(self.order, k=-1)
        matrix[0] = self.coefficients
        return matrix

    @cached_property
    def stationary_covariance(self) -> Array:
        """(p, p) covariance of p successive values, unit diagonal."""
        forcing = np.zeros((self.order, self.order))
        forcing[0, 0] = 1.0
        covariance = solve_discrete_lyapunov(self.transition, forcing)
        return covariance / covariance[0, 0]

    @property
    def innovation_variance(self) -> float:
        """Variance of an innovation, the process having variance 1."""
        if not self.order:
            return 1.0
        covariance, transition = self.stationary_covariance, self.transition
        return float((covariance - transition @ covariance @ transition.T)[0, 0])

    def autocorrelation(self, count: int) -> Array:
        """(count,) autocorrelation at lags 0 .. count - 1."""
        if not self.order:
            return np.eye(1, count)[0]
        state = self.stationary_covariance[:, 0]
        values = np.empty(count)
        for lag in range(count):
            values[lag] = state[0]
            state = self.transition @ state
        return values

    @classmethod
    def from_partial(cls, partial: ArrayLike) -> Autoregression:
        """From partial autocorrelations, each inside (-1, 1): always stationary (Durbin and Levinson)."""
        coefficients: list[float] = []
        for reflection in np.asarray(partial, dtype=float):
            mirrored = [
                float(a - reflection * b) for a, b in zip(coefficients, reversed(coefficients), strict=True)
            ]
            coefficients = [*mirrored, float(reflection)]
        return cls(tuple(coefficients))


class GapWhitener:
    """L^-1 over frames for several series at once, each with its own scale and its own gaps.

    Series m has covariance process_std[m]^2 C + white_std[m]^2 I over its observed frames, C the
    autocorrelation of `process`.

    process: the AR process of unit variance.
    process_std, white_std: (M,) standard deviations, in the unit of what is whitened.
    observed: (T, M) bool; frames that are False carry nothing and come back as zeros.
    Raises ValueError when a series has no noise at all.
    """

    def __init__(
        self, process: Autoregression, process_std: Array, white_std: Array, observed: NDArray[np.bool_]
    ) -> None:
        total = process_std**2 + white_std**2
        if not np.all(np.isfinite(total)) or np.any(total <= 0.0):
            raise ValueError(
                f"noise of series {int(np.argmin(total))}: expected a positive standard deviation"
            )
        self.observed = np.asarray(observed, dtype=bool)
        self._coefficients = process.coefficients
        frames, series = self.observed.shape
        order = process.order
        self._deviation = np.empty((frames, series))
        self._gain = np.zeros((frames, order, series))
        if not order:
            self._deviation[:] = np.sqrt(total)
            return
        transition = process.transition
        covariance = process.stationary_covariance * (process_std**2)[:, None, None]
        forcing = np.zeros_like(covariance)
        forcing[:, 0, 0] = process.innovation_variance * process_std**2
        for t in range(frames):
            variance = covariance[:, 0, 0] + white_std**2
            self._deviation[t] = np.sqrt(variance)
            gain = np.where(self.observed[t], covariance[:, :, 0].T / variance, 0.0)
            self._gain[t] = gain
            updated = covariance - (gain * variance).T[:, :, None] * gain.T[:, None, :]
            covariance = transition @ updated @ transition.T + forcing

    @property
    def log_determinant(self) -> Array:
        """(M,) log |L| of each series over its observed frames, one coordinate."""
        return np.where(self.observed, np.log(self._deviation), 0.0).sum(0)

    def whiten(self, array: Array) -> Array:
        """L^-1 of (T, M, ...) along frames; the same shape, zero where not observed."""
        values = self._columns(array)
        out = np.zeros_like(values)
        state = [np.zeros(values.shape[1:]) for _ in self._coefficients]
        for t, frame in enumerate(values):
            seen = self.observed[t][:, None]
            innovation = np.where(seen, frame - state[0] if state else frame, 0.0)
            np.divide(innovation, self._deviation[t][:, None], out=out[t])
            if state:
                state = [a + k[:, None] * innovation for a, k in zip(state, self._gain[t], strict=True)]
                ahead = sum(c * a for c, a in zip(self._coefficients, state, strict=True))
                state = [np.asarray(ahead), *state[:-1]]
        return out.reshape(array.shape)

    def whiten_transposed(self, array: Array) -> Array:
        """L^-T of (T, M, ...), the adjoint of `whiten`; the same shape, zero where not observed."""
        values = self._columns(array)
        out = np.zeros_like(values)
        # Adjoint of the state carried backwards through the same gains.
        carried = [np.zeros(values.shape[1:]) for _ in self._coefficients]
        for t in range(len(values) - 1, -1, -1):
            updated = []
            for i, c in enumerate(self._coefficients):
                following = carried[i + 1] if i + 1 < len(carried) else 0.0
                updated.append(c * carried[0] + following)
            weighted = values[t] / self._deviation[t][:, None]
            for gain, value in zip(self._gain[t], updated, strict=True):
                weighted = weighted + gain[:, None] * value
            out[t] = np.where(self.observed[t][:, None], weighted, 0.0)
            if updated:
                carried = [updated[0] - out[t], *updated[1:]]
        return out.reshape(array.shape)

    def _columns(self, array: Array) -> Array:
        if array.shape[:2] != self.observed.shape:
            raise ValueError(f"array of shape {array.shape}: expected {self.observed.shape} first")
        return np.asarray(array, dtype=float).reshape(*array.shape[:2], -1)
