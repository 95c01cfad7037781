"""The floor: is what the model leaves no more than noise and the discretisation's share, everywhere and
always.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, f

from mphygs.compare.allowance import Allowance
from mphygs.compare.blocks import Block, Blocks
from mphygs.compare.holm import holm
from mphygs.compare.residual_projection import RANK_TOLERANCE, project_out

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Floor:
    """Misfit against the floor.

    chi_square: rᵀPr with the allowance in; degrees: N - rank; limit: the quantile of it at 1 - level.
    p_value: of a misfit this large; p_value_low: of one this small, which means that the noise is overstated.
    block_ratio: (B,) chi² of each block over its expectation. block_p_values: (B,) after Holm.
    """

    chi_square: float
    degrees: int
    limit: float
    level: float
    p_value: float
    p_value_low: float
    blocks: tuple[Block, ...]
    block_ratio: Array
    block_p_values: Array

    @property
    def significant_blocks(self) -> tuple[int, ...]:
        """Indices of blocks above the floor, the worst first."""
        found = np.nonzero(self.block_p_values < self.level)[0]
        return tuple(int(b) for b in found[np.argsort(-self.block_ratio[found])])

    @property
    def reached(self) -> bool:
        """Whether misfit and every block are no more than the floor."""
        return self.chi_square <= self.limit and not self.significant_blocks

    @property
    def noise_overstated(self) -> bool:
        """Whether the misfit is too small for the noise that was stated."""
        return self.p_value_low < self.level


def floor_test(
    residual: Array,
    jacobian: Array,
    blocks: Blocks,
    *,
    allowance: Allowance | None = None,
    noise_degrees: float = np.inf,
    level: float = 0.01,
    rank_tolerance: float = RANK_TOLERANCE,
) -> Floor:
    """Test the whitened residual (N,) of the fitted model, Jacobian (N, p), against the floor.

    allowance: the discretisation's share. noise_degrees: degrees of freedom behind the noise's scale where
    that was measured (NoiseModel.scale_degrees), infinite for a stated one: many observations test a scale
    more finely than a short rest determines it. Rows of a prior may follow the blocks' observations. Raises
    ValueError when nothing is left to test.
    """
    allowance = allowance or Allowance()
    projection = project_out(allowance.apply_jacobian(jacobian), rank_tolerance=rank_tolerance)
    remaining = projection.remaining(allowance.apply(residual))
    degrees = len(remaining) - projection.rank
    if degrees < 1:
        raise ValueError(f"{len(residual)} observations for {projection.rank} parameters: expected more")
    chi_square = float(remaining @ remaining)
    ratios, p_values = np.zeros(len(blocks)), np.ones(len(blocks))
    for b, rows in enumerate(blocks.rows()):
        basis = projection.basis[rows]
        covered = basis.T @ basis
        # First two moments of rᵀ P_b r, matched by a scaled chi-square (Satterthwaite, 1946).
        mean = len(rows) - float(np.trace(covered))
        variance = 2.0 * (len(rows) - 2.0 * float(np.trace(covered)) + float((covered**2).sum()))
        if mean <= 1e-6 * len(rows):
            continue
        ratios[b] = float(remaining[rows] @ remaining[rows]) / mean
        p_values[b] = above(ratios[b], 2.0 * mean**2 / variance, noise_degrees)
    adjusted = holm({str(b): float(p) for b, p in enumerate(p_values)})
    ratio = chi_square / degrees
    quantile = chi2.isf(level, degrees) / degrees
    if np.isfinite(noise_degrees):
        quantile = f.isf(level, degrees, noise_degrees)
    p_value = above(ratio, degrees, noise_degrees)
    return Floor(
        chi_square=chi_square,
        degrees=degrees,
        limit=float(quantile * degrees),
        level=level,
        p_value=p_value,
        p_value_low=1.0 - p_value,
        blocks=blocks.blocks,
        block_ratio=ratios,
        block_p_values=np.array([adjusted[str(b)] for b in range(len(blocks))]),
    )


def above(ratio: float, degrees: float, noise_degrees: float) -> float:
    """P of a mean square of noise this large or larger, its scale known, or measured by so many degrees."""
    if np.isfinite(noise_degrees):
        return float(f.sf(ratio, degrees, noise_degrees))
    return float(chi2.sf(ratio * degrees, degrees))
