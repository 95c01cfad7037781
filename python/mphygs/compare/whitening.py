"""Noise of marker residuals, and whitening with it.

Every coordinate of every marker carries autoregressive noise plus white noise over frames, and all markers of
a frame may share a jitter. The covariance R is learnt from points that cannot move or taken as stated, never
from the misfit: the misfit's own correlation would hide slow effects.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import toeplitz
from scipy.stats import chi2

from mphygs.compare.autoregression import Array, Autoregression, GapWhitener
from mphygs.compare.rest_noise import MAXIMUM_ORDER, fit_common, fit_rest, without_common

# With fewer frames at rest the restricted likelihood still runs, but the correlation time it finds cannot be
# longer than the footage: the stated sigma, taken as white, is then the better guess.
MINIMUM_REST_FRAMES = 20
# Scatter at rest overrules the stated sigma, or one marker's differs from the others', at this level.
SCALE_LEVEL = 0.001


@dataclass(frozen=True, kw_only=True)
class NoiseModel:
    """Noise of one measured coordinate.

    sigma: () or (M,) [m] standard deviation, common jitter not included.
    correlated_share: () or (M,) share of sigma^2 that follows `correlation`, the rest is white.
    correlation: autoregression over frames, shared by the markers.
    common_sigma: () or (C,) [m] jitter shared by all markers of a frame, per coordinate; 0 without.
    common_correlation: its autoregression.
    source: where all this comes from, in words.
    scale_degrees: degrees of freedom behind the scale, infinite when it was stated.
    """

    sigma: Array
    source: str
    correlated_share: Array
    correlation: Autoregression
    common_sigma: Array
    common_correlation: Autoregression
    scale_degrees: float = np.inf

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.sigma)) or np.any(np.asarray(self.sigma) <= 0.0):
            raise ValueError(f"sigma {self.sigma}: expected positive standard deviations in metres")
        if np.any(np.asarray(self.correlated_share) < 0.0) or np.any(np.asarray(self.correlated_share) > 1.0):
            raise ValueError(f"correlated_share {self.correlated_share}: expected values in [0, 1]")
        if not np.all(np.isfinite(self.common_sigma)) or np.any(np.asarray(self.common_sigma) < 0.0):
            raise ValueError(f"common_sigma {self.common_sigma}: expected 0 or more metres")

    @classmethod
    def white(cls, sigma: ArrayLike, source: str) -> NoiseModel:
        """Uncorrelated noise of standard deviation sigma, () or (M,) [m]."""
        none = np.asarray(0.0)
        return cls(
            sigma=np.asarray(sigma, dtype=float),
            source=source,
            correlated_share=none,
            correlation=Autoregression(),
            common_sigma=none,
            common_correlation=Autoregression(),
        )

    def whiten(self, array: Array, observed: NDArray[np.bool_]) -> Array:
        """(T, M, C, ...) -> (N, ...); see Whitener, which is the faster way for several arrays."""
        return Whitener(self, observed, array.shape[2]).whiten(array)


class Whitener:
    """L^-1 of a noise model for one set of observed markers; apply it to residuals and to Jacobians alike.

    observed: (T, M) bool. coordinates: C per marker.
    frame, marker, coordinate: (N,) int, what each whitened row chiefly belongs to (frame by frame). A row is
    whitened with the frames before it and, where there is a common jitter, with its neighbours.
    course: (T,) what all of the noise is multiplied by, frame by frame; None where it is the same in all.
    """

    def __init__(
        self,
        noise: NoiseModel,
        observed: NDArray[np.bool_],
        coordinates: int = 3,
        course: Array | None = None,
    ) -> None:
        self.observed = np.asarray(observed, dtype=bool)
        if self.observed.ndim != 2:
            raise ValueError(f"observed has shape {self.observed.shape}: expected (frames, markers)")
        frames, markers = self.observed.shape
        self._course = np.ones(frames) if course is None else np.asarray(course, float)
        if self._course.shape != (frames,) or not (self._course > 0.0).all():
            raise ValueError(f"course of shape {self._course.shape}: expected ({frames},), above zero")
        sigma = np.broadcast_to(noise.sigma, (markers,))
        share = np.broadcast_to(noise.correlated_share, (markers,))
        correlated, white = sigma * np.sqrt(share), sigma * np.sqrt(1.0 - share)
        self._time = GapWhitener(noise.correlation, correlated, white, self.observed)
        self.coordinates = coordinates
        rows = np.broadcast_to(self.observed[..., None], (frames, markers, coordinates))
        self.frame, self.marker, self.coordinate = np.nonzero(rows)
        self._common = np.broadcast_to(noise.common_sigma, (coordinates,))
        if np.any(self._common > 0.0):
            self._root = np.linalg.cholesky(toeplitz(noise.common_correlation.autocorrelation(frames)))
            self._basis, self._shrink = self._common_modes(noise.correlation, correlated, white)

    @property
    def row_count(self) -> int:
        """Number of whitened rows, N."""
        return len(self.frame)

    def whiten(self, array: Array) -> Array:
        """(T, M, C, ...) [m, or m per parameter] -> (N, ...) of unit variance; NaN fine where unobserved."""
        array = np.asarray(array, dtype=float)
        expected = (*self.observed.shape, self.coordinates)
        if array.shape[:3] != expected:
            raise ValueError(f"array of shape {array.shape}: expected {expected} first")
        rows = array[self.frame, self.marker, self.coordinate]
        if not np.all(np.isfinite(rows)):
            bad = int(np.argmin(np.isfinite(rows.reshape(len(rows), -1)).all(1)))
            raise ValueError(f"frame {self.frame[bad]}, marker {self.marker[bad]}: observed but not finite")
        values = self._time.whiten(self._steady(array))
        if np.any(self._common > 0.0):
            values = self._remove_common(values)
        return values[self.frame, self.marker, self.coordinate]

    def whiten_transposed(self, rows: Array) -> Array:
        """L^-T of whitened rows (N, ...), the adjoint of `whiten`: (T, M, C, ...), zero where unobserved."""
        rows = np.asarray(rows, dtype=float)
        if len(rows) != self.row_count:
            raise ValueError(f"{len(rows)} rows: expected {self.row_count}")
        values = np.zeros((*self.observed.shape, self.coordinates, *rows.shape[1:]))
        values[self.frame, self.marker, self.coordinate] = rows
        if np.any(self._common > 0.0):
            values = self._remove_common(values)  # symmetric
        return self._steady(self._time.whiten_transposed(values))

    def _steady(self, array: Array) -> Array:
        """(T, ...) as it would be with noise that is the same in all frames."""
        if (self._course == 1.0).all():
            return array
        return array / self._course.reshape(-1, *(1,) * (array.ndim - 1))

    def _spread(self, amplitudes: Array) -> Array:
        """Common jitter of unit scale, amplitudes (T, ...), as whitened series (T, M, ...)."""
        course = np.tensordot(self._root, amplitudes, axes=1)
        return self._time.whiten(np.repeat(course[:, None], self.observed.shape[1], axis=1))

    def _remove_common(self, values: Array) -> Array:
        # With B the whitened common modes, (I + B Bᵀ)^-1/2 = I - B V f(g) Vᵀ Bᵀ, Bᵀ B = V g Vᵀ.
        gathered = np.tensordot(self._root.T, self._time.whiten_transposed(values).sum(1), axes=1)
        modal = np.tensordot(self._basis.T, gathered, axes=1)
        modal *= self._shrink.reshape(self._shrink.shape + (1,) * (values.ndim - 3))
        out = values - self._spread(np.tensordot(self._basis, modal, axes=1))
        return np.where(self.observed.reshape(self.observed.shape + (1,) * (values.ndim - 2)), out, 0.0)

    def _common_modes(
        self, correlation: Autoregression, correlated: Array, white: Array
    ) -> tuple[Array, Array]:
        """Eigenvectors (T, T) of the modes' Gram matrix, (T, C) factors (1 - 1/sqrt(1 + s^2 g)) / g."""
        frames = len(self.observed)
        # Markers with equal gaps and noise act alike: one of each kind is enough.
        kinds, counts = np.unique(np.vstack([self.observed, correlated, white]), axis=1, return_counts=True)
        one = GapWhitener(correlation, kinds[frames], kinds[frames + 1], kinds[:frames] > 0.5)
        gram = np.empty((frames, frames))
        chunk = max(1, 2_000_000 // (frames * len(counts)))
        for begin in range(0, frames, chunk):
            unit = np.repeat(self._root[:, None, begin : begin + chunk], len(counts), axis=1)
            applied = one.whiten_transposed(one.whiten(unit))
            gram[:, begin : begin + chunk] = self._root.T @ np.einsum(
                "k,tkc->tc", counts.astype(float), applied
            )
        eigenvalues, basis = np.linalg.eigh(0.5 * (gram + gram.T))
        power = np.maximum(eigenvalues, 0.0)[:, None]
        scaled = self._common**2 * power
        # (1 - 1/sqrt(1 + x)) / g written without cancellation for small x = s^2 g.
        root = np.sqrt(1.0 + scaled)
        return basis, self._common**2 / (root * (1.0 + root))


def noise_from_rest(rest: Array | None, sigma: float | None, *, what: str = "markers at rest") -> NoiseModel:
    """Noise model from footage of points that cannot move, or from the stated sigma.

    rest: (T0, M, C) [m] positions, NaN where missing, of points that do not move; None without such footage.
    sigma: stated standard deviation of a coordinate [m] or None.
    what: names the footage in `source`.

    Correlation is trusted from MINIMUM_REST_FRAMES frames on. The stated sigma stays unless the rest scatters
    significantly more: still markers do not show the errors that come with motion, so a smaller scatter at
    rest does not lower it; what it exceeds the scatter by is taken as white. The result is per marker where
    the rest overrules it, or where sigma is None and the markers differ.
    Raises ValueError without either source, or when sigma is None and the rest is too short.
    """
    if sigma is not None and not (np.isfinite(sigma) and sigma > 0.0):
        raise ValueError(f"stated sigma {sigma}: expected a positive number of metres")
    if rest is None:
        if sigma is None:
            raise ValueError("noise: expected footage at rest or a stated sigma")
        return NoiseModel.white(sigma, "stated sigma, taken as white")
    if rest.ndim != 3:
        raise ValueError(f"rest has shape {rest.shape}: expected (frames, markers, coordinates)")
    observed = np.isfinite(rest).all(2)
    usable = observed.sum(0) >= MINIMUM_REST_FRAMES
    # Points that do not scatter at all were not measured: they say nothing of noise.
    usable &= np.array([np.ptp(rest[observed[:, m], m], axis=0).max() > 0.0 if ok else False
                        for m, ok in enumerate(usable)], dtype=bool)  # fmt: skip
    if not usable.any():
        if sigma is None:
            raise ValueError(
                f"{what}: {len(rest)} frames, expected {MINIMUM_REST_FRAMES} or more, or a stated sigma"
            )
        short = "too few" if len(rest) < MINIMUM_REST_FRAMES else "none of them with a noise"
        return NoiseModel.white(sigma, f"stated sigma, taken as white ({what}: {len(rest)} frames, {short})")
    series = np.where(observed[..., None], rest, 0.0)[:, usable]
    observed = observed[:, usable]
    order = min(MAXIMUM_ORDER, int(observed.sum(0).max()) // 10)
    fit = fit_rest(series, observed, maximum_order=order)
    common = fit_common(series, observed, fit)
    if common is not None:
        fit = fit_rest(without_common(series, observed), observed, maximum_order=order)
        if sigma is not None:
            # What is stated is of all noise, the common jitter included, which is told apart from here on.
            own = sigma**2 - float(np.mean(common.variance))
            sigma = float(np.sqrt(max(own, min(sigma**2, float(np.median(fit.variance))))))
    variance, scale_degrees, words = _scale(fit.variance, fit.degrees, sigma)
    share = (
        _correlated_share(fit.variance, fit.degrees, variance)
        if fit.process.order
        else np.zeros_like(variance)
    )
    full_variance, full_share = (
        np.full(rest.shape[1], np.median(variance)),
        np.full(rest.shape[1], np.median(share)),
    )
    full_variance[usable], full_share[usable] = variance, share
    kind = f"correlated over frames, AR({fit.process.order})" if fit.process.order else "white"
    jitter = "" if common is None else ", with a jitter common to all markers"
    return NoiseModel(
        sigma=np.sqrt(full_variance),
        correlated_share=full_share,
        correlation=fit.process,
        common_sigma=np.asarray(0.0) if common is None else np.sqrt(common.variance),
        common_correlation=Autoregression() if common is None else common.process,
        source=f"{what} ({len(rest)} frames): {kind}{jitter}; {words}",
        scale_degrees=scale_degrees,
    )


def _correlated_share(variance: Array, degrees: Array, total: Array) -> Array:
    """Share of the total the rest accounts for; all of it unless the rest is significantly quieter."""
    quieter = chi2.cdf(degrees * variance / total, degrees) < SCALE_LEVEL / len(variance)
    return np.where(quieter, variance / total, 1.0)


def _scale(variance: Array, degrees: Array, sigma: float | None) -> tuple[Array, float, str]:
    """Variance (M,), degrees of freedom behind the mean of them all, and where it comes from in words."""
    level = SCALE_LEVEL / len(variance)
    stated = None if sigma is None else sigma**2
    pooled = float((degrees * variance).sum() / degrees.sum())
    reference = pooled if stated is None else stated
    louder = chi2.sf(degrees * variance / reference, degrees) < level
    # Whitening divides by the variance: this is the estimate whose inverse has no bias.
    single = variance * degrees / (degrees - 2.0)
    measured_degrees = len(variance) ** 2 / float((1.0 / degrees).sum())
    if stated is not None:
        if louder.any():
            behind = len(variance) ** 2 / float((1.0 / degrees[louder]).sum())
            return (
                np.where(louder, single, stated),
                behind,
                f"{int(louder.sum())} markers scatter more than stated",
            )
        return np.full_like(variance, stated), np.inf, "scale as stated"
    quieter = chi2.cdf(degrees * variance / reference, degrees) < level
    if (louder | quieter).any():
        return single, measured_degrees, "scale measured per marker"
    return np.full_like(variance, pooled), float(degrees.sum()), "scale measured"
