"""How sure a fit's numbers are: by the noise, by what the model leaves of it, and by the grid.

The inverse of the normal matrix is the noise's share alone. Where a model leaves more than the noise, what it
leaves counts as noise: the residual variance scales the covariance (Seber & Wild, "Nonlinear regression",
1989, section 2.1.2). The grid bends numbers by what a finer one would still move them: its error falls with
the square of the spacing, so the change from a coarser grid tells it (Richardson extrapolation).
"""

from __future__ import annotations

import numpy as np

from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.problem import Evaluation
from mphygs.model.belief import Belief


def spread_of(evaluation: Evaluation, grid: np.ndarray | None = None) -> np.ndarray:
    """Covariance of the free coordinates at a minimum, (P, P). grid: see `grid_change`."""
    spread = covariance(evaluation) * max(evaluation.misfit, 1.0) ** 2
    return spread if grid is None else spread + np.outer(grid, grid)


def grid_change(coarse: Belief, fine: Belief, ratio: float) -> np.ndarray:
    """(P,) how far the free coordinates are from where an ever finer grid would lead: their change from a
    coarser grid over ratio^2 - 1. ratio: of the spacings, above 1; what stood at a bound, or is new, says
    nothing. Raises ValueError for a ratio of 1 or less.
    """
    if not ratio > 1.0:
        raise ValueError(f"ratio of spacings {ratio:g}; expected above 1")
    before = {p.key: p for p in coarse.free}
    return np.array(
        [
            (p.coordinate - before[p.key].coordinate) / (ratio**2 - 1.0)
            if p.key in before and not (p.at_bound or before[p.key].at_bound)
            else 0.0
            for p in fine.free
        ]
    )
