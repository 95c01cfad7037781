"""Many candidates at once: Holm's correction and the parametric bootstrap of the strongest.

The bootstrap needs no arrays of the observations: under the null the joint score of all candidates is normal
with the joint information as covariance, so a draw costs as little as the candidates are few.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mphygs.diagnose.cone import cone_maximum, mixture_p_value, mixture_p_value_of_share
from mphygs.diagnose.score_table import Score, ScoreTable

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class FamilyLaw:
    """What the candidates of one table do when none of them is there, B simulated data sets, E testable ones.

    names: of the testable candidates. drops, p_values: (B, E).
    """

    names: tuple[str, ...]
    drops: Array
    p_values: Array

    @property
    def largest_drop(self) -> Array:
        """(B,) max over candidates of the drop in chi²."""
        return self.drops.max(1)

    @property
    def smallest_p_value(self) -> Array:
        """(B,) min over candidates, which does not favour those with many parameters."""
        return self.p_values.min(1)

    def p_value(self, score: Score) -> float:
        """Chance that any candidate would look as significant as this one under the null.

        Where too few simulated sets reach it, the union bound (candidates times p-value) takes over.
        """
        reached = int(np.count_nonzero(self.smallest_p_value <= score.p_value))
        simulated = (1.0 + reached) / (1.0 + len(self.p_values))
        return min(1.0, simulated, len(self.names) * score.p_value)

    def p_value_of_drop(self, drop: float) -> float:
        """Chance that the largest drop reaches this one under the null, by simulation alone."""
        return float((1.0 + np.count_nonzero(self.largest_drop >= drop)) / (1.0 + len(self.drops)))


def simulate_family(table: ScoreTable, *, generator: np.random.Generator, draws: int = 2000) -> FamilyLaw:
    """Parametric bootstrap of every testable candidate under the null of the table.

    Raises ValueError when none is testable.
    """
    tested = [score for score in table.scores if score.testable]
    if not tested:
        raise ValueError("family: expected at least one testable candidate")
    values, vectors = np.linalg.eigh(table.joint_information)
    kept = values > 1e-10 * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
    normal = generator.standard_normal((draws, int(kept.sum())))
    joint = (normal * np.sqrt(values[kept])) @ vectors[:, kept].T
    drops = np.empty((draws, len(tested)))
    p_values = np.empty((draws, len(tested)))
    outside = table.degrees - int(kept.sum())
    chi_square = (normal**2).sum(1) + (generator.chisquare(outside, draws) if outside > 0 else 0.0)
    for column, score in enumerate(tested):
        place = table.columns(score.name)
        gain, _, _ = cone_maximum(
            joint[:, place], table.joint_information[place, place], table.bounded[place]
        )
        drops[:, column] = gain
        if table.sigma_known:
            p_values[:, column] = mixture_p_value(gain, score.weights)
        else:
            share = np.minimum(gain / chi_square, 1.0)
            p_values[:, column] = mixture_p_value_of_share(share, score.weights, table.degrees)
    return FamilyLaw(names=tuple(score.name for score in tested), drops=drops, p_values=p_values)
