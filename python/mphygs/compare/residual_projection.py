"""The part of an observation that refitting the parameters could absorb, and what is left of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# Columns scaled to length 1 are dependent below this; tangents come from single-precision simulations.
RANK_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Projection:
    """P = I - Q Qᵀ for the whitened Jacobian J of the fitted parameters.

    basis: (N, rank) orthonormal Q. solve: (p, rank) with pinv(J) = solve Qᵀ.
    """

    basis: Array
    solve: Array

    @property
    def rank(self) -> int:
        """Number of directions that are removed."""
        return self.basis.shape[1]

    @property
    def parameter_count(self) -> int:
        """Number of fitted parameters, p."""
        return self.solve.shape[0]

    def remaining(self, array: Array) -> Array:
        """P x of (N, ...), the same shape."""
        left = array - self.basis @ (self.basis.T @ array)
        # Once more: a column that is nearly all absorbed would otherwise keep rounding errors along Q.
        return left - self.basis @ (self.basis.T @ left)

    def absorbing(self, array: Array) -> Array:
        """(p, ...) parameter change pinv(J) x that reproduces the absorbed part of (N, ...)."""
        return self.solve @ (self.basis.T @ array)


def project_out(jacobian: Array, *, rank_tolerance: float = RANK_TOLERANCE) -> Projection:
    """Projection that removes the range of J (N, p), p = 0 allowed.

    Columns are scaled to unit length before their rank is judged; directions below `rank_tolerance` of the
    largest singular value are left out, and move no parameter. Raises ValueError on non-finite entries.
    """
    jacobian = np.asarray(jacobian, dtype=float)
    if jacobian.ndim != 2:
        raise ValueError(f"Jacobian of shape {jacobian.shape}: expected (observations, parameters)")
    if not np.all(np.isfinite(jacobian)):
        bad = int(np.argmin(np.isfinite(jacobian).all(0)))
        raise ValueError(f"Jacobian column {bad}: expected finite numbers")
    length = np.linalg.norm(jacobian, axis=0)
    scale = np.where(length > 0.0, length, 1.0)
    orthonormal, triangle = np.linalg.qr(jacobian / scale)
    left, singular, right = np.linalg.svd(triangle, full_matrices=False)
    kept = singular > rank_tolerance * (singular[0] if singular.size else 1.0)
    solve = (right[kept].T / singular[kept]) / scale[:, None]
    return Projection(orthonormal @ left[:, kept], solve)
