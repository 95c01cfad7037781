"""The discretisation's share of the misfit, allowed for in every test.

Refining the model changes the prediction by a field delta. What that says about the error still in the model
is carried in two ways, alone or together: as extra variance of single observations, and as directions with a
random amplitude (R + D Dᵀ), of which refitting absorbs what it can. Directions are the right way for a field
that is smooth in time, which extra variance would take for many independent errors.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Allowance:
    """Covariance added to the identity of whitened observations: diag(variance) + directions directionsᵀ.

    variance: () or (N,) in units of the noise variance. directions: (N, k), whitened; k = 0 without.
    """

    variance: Array = field(default_factory=lambda: np.asarray(0.0))
    directions: Array | None = None

    def __post_init__(self) -> None:
        variance = np.asarray(self.variance)
        if not np.all(np.isfinite(variance)) or np.any(variance < 0.0):
            raise ValueError("allowance: expected finite variances of 0 or more")
        if self.directions is not None and not np.all(np.isfinite(self.directions)):
            raise ValueError("allowance: expected finite directions")

    @property
    def extra_rows(self) -> int:
        """Rows `apply` appends."""
        return 0 if self.directions is None else self.directions.shape[1]

    def apply(self, array: Array) -> Array:
        """(N, ...) -> (N + k, ...): scaled to unit variance again, zeros appended for the prior."""
        array = np.asarray(array, dtype=float)
        weight = 1.0 / np.sqrt(1.0 + np.broadcast_to(self.variance, (len(array),)))
        scaled = array * weight.reshape(-1, *(1,) * (array.ndim - 1))
        return np.concatenate([scaled, np.zeros((self.extra_rows, *array.shape[1:]))])

    def apply_jacobian(self, jacobian: Array) -> Array:
        """(N, p) -> (N + k, p + k): the directions become parameters with prior standard deviation 1."""
        columns = self.apply(jacobian)
        if self.directions is None:
            return columns
        nuisance = self.apply(self.directions)
        nuisance[len(jacobian) :] = np.eye(self.extra_rows)
        return np.concatenate([columns, nuisance], axis=1)


def modulated_directions(
    delta: Array, part: NDArray[np.int_], frame: NDArray[np.int_], *, count: int
) -> Array:
    """Directions D with the envelope of delta, part by part, whose amplitude drifts over time.

    The error left in a model has about the size of the change under refinement but not its exact course:
    delta (N,) is multiplied by `count` cosines over frames, separately in every part, weighted so that the
    amplitude has variance 1 on average over frames.

    part, frame: (N,) of each whitened row. Returns (N, parts * count).
    """
    if count < 1:
        raise ValueError(f"modulated_directions: count {count}, expected 1 or more")
    first, last = int(frame.min()), int(frame.max())
    phase = np.pi * (frame - first + 0.5) / (last - first + 1)
    cosines = np.cos(phase[:, None] * np.arange(count)) * np.sqrt(
        np.where(np.arange(count) == 0, 1.0, 2.0) / count
    )
    columns = [np.where((part == name)[:, None], delta[:, None] * cosines, 0.0) for name in np.unique(part)]
    return np.concatenate(columns, axis=1)


def local_variance(delta: Array, block: NDArray[np.int_]) -> Array:
    """(N,) mean square of delta (N,) over the block each row is in: extra variance without directions."""
    _, index = np.unique(block, return_inverse=True)
    return (np.bincount(index, delta**2) / np.bincount(index))[index]
