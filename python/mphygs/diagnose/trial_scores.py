"""Threshold effects and shape-like parameters: finite trials, and the law of the best of them.

A trial changes the prediction by d = h(trial) - h(null). With the fitted parameters giving way it changes
chi² by 2 dᵀPr - dᵀPd; nothing is scaled, since a yield stress or a relaxation time has no amplitude.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from mphygs.compare.allowance import Allowance
from mphygs.compare.residual_projection import RANK_TOLERANCE, project_out
from mphygs.diagnose.score import MAXIMUM_ABSORBED

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class TrialScores:
    """Outcome of G trials of one effect.

    drops: (G,) predicted drop of chi², negative where the trial makes it worse. best: index of the largest.
    p_value: chance of a best drop at least as large under the null.
    absorbed: (G,) share of each change that the fitted parameters absorb; testable: (G,) whether it can be
    told; powers: (G,) sum of squares of the rest. shifts: (p, G) change of the fitted parameters that goes
    with each trial.
    """

    drops: Array
    best: int
    p_value: float
    absorbed: Array
    testable: NDArray[np.bool_]
    powers: Array
    shifts: Array

    @property
    def drop(self) -> float:
        """Of the best trial, 0 when none helps."""
        return max(float(self.drops[self.best]), 0.0)


def score_trials(
    residual: Array,
    jacobian: Array,
    changes: Array,
    *,
    generator: np.random.Generator,
    allowance: Allowance | None = None,
    draws: int = 4000,
    rank_tolerance: float = RANK_TOLERANCE,
) -> TrialScores:
    """Best trial and its p-value, the choice among trials taken into account.

    residual: (N,), jacobian: (N, p), changes: (N, G), whitened. The maximum is simulated under the null;
    where too few draws reach it, the union bound over trials takes over. Raises ValueError without trials or
    on non-finite changes.
    """
    if changes.ndim != 2 or changes.shape[1] == 0 or len(changes) != len(residual):
        raise ValueError(f"trials of shape {changes.shape}: expected ({len(residual)}, at least one)")
    if not np.all(np.isfinite(changes)):
        raise ValueError(f"trial {int(np.argmin(np.isfinite(changes).all(0)))}: expected finite changes")
    allowance = allowance or Allowance()
    projection = project_out(allowance.apply_jacobian(jacobian), rank_tolerance=rank_tolerance)
    weighted = allowance.apply(changes)
    left = projection.remaining(weighted)
    gram = left.T @ left
    power = np.diag(gram)
    total = (weighted**2).sum(0)
    absorbed = np.where(total > 0.0, 1.0 - power / np.where(total > 0.0, total, 1.0), 1.0)
    testable = absorbed < MAXIMUM_ABSORBED
    drops = 2.0 * (left.T @ allowance.apply(residual)) - power
    best = int(np.argmax(np.where(testable, drops, -np.inf)))
    shifts = -projection.absorbing(weighted)[: jacobian.shape[1]]
    p_value = 1.0
    if testable[best] and drops[best] > 0.0:
        p_value = _best_p_value(float(drops[best]), gram[np.ix_(testable, testable)], generator, draws)
    return TrialScores(
        drops=drops, best=best, p_value=p_value, absorbed=absorbed, testable=testable, powers=power,
        shifts=shifts,
    )  # fmt: skip


def _best_p_value(drop: float, gram: Array, generator: np.random.Generator, draws: int) -> float:
    values, vectors = np.linalg.eigh(gram)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    power = np.diag(gram)
    # Under the null dᵀPr is normal with covariance dᵀPd.
    maxima = (2.0 * generator.standard_normal((draws, len(power))) @ root.T - power).max(1)
    simulated = (1.0 + np.count_nonzero(maxima >= drop)) / (1.0 + draws)
    union = float(norm.sf((drop + power) / (2.0 * np.sqrt(power))).sum())
    return min(simulated, union, 1.0)
