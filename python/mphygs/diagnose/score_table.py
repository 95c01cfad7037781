"""Candidate effects and what their score test says: the records every later step of diagnosis reads."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """One effect and how the prediction starts to move with it.

    tangent: (N, q) whitened derivative of the prediction at the null, per unit of each parameter.
    lower_bounded: (q,) parameters that cannot fall below their null.
    null: (q,) values at which the effect is absent.
    """

    name: str
    tangent: Array
    lower_bounded: NDArray[np.bool_]
    null: Array

    def __post_init__(self) -> None:
        if self.tangent.ndim != 2 or self.tangent.shape[1] == 0:
            raise ValueError(f"{self.name}: tangent of shape {self.tangent.shape}, expected (N, parameters)")
        count = self.tangent.shape[1]
        if np.shape(self.lower_bounded) != (count,) or np.shape(self.null) != (count,):
            raise ValueError(
                f"{self.name}: lower_bounded and null: expected {count} entries, as in the tangent"
            )
        if not np.all(np.isfinite(self.tangent)):
            raise ValueError(f"{self.name}: expected a finite tangent")


@dataclass(frozen=True, kw_only=True)
class Score:
    """What the test says of one candidate, q its parameters.

    testable: whether anything can be said; reason: why not, empty otherwise.
    statistic: S, bounds ignored.
    drop: gain in chi² with the bounds kept, the predicted drop; S without bounds.
    weights: (q + 1,) of the chi-bar-square law of `drop`.
    p_value: of `drop`, one-sided where bounded.
    estimate: (q,) value of the parameters, null added, bounds kept; unbounded: (q,) the same without bounds.
    std: (q,) of `unbounded`; infinite where the motion does not determine the parameter.
    score, information: (q,), (q, q) u and I, untestable directions removed.
    shift: (p,) change of the fitted parameters that goes with `estimate`: what was absorbing the effect.
    absorbed: (q,) share of each parameter's tangent that the fitted parameters absorb.
    absorbed_share: the same of the direction that is tested best.
    expected_chi_square: rᵀ P r once the effect is in.
    expected_rms: square root of its mean over the observations, in standard deviations of the noise.
    """

    name: str
    testable: bool
    reason: str
    statistic: float
    drop: float
    weights: Array
    p_value: float
    estimate: Array
    unbounded: Array
    std: Array
    score: Array
    information: Array
    shift: Array
    absorbed: Array
    absorbed_share: float
    expected_chi_square: float
    expected_rms: float

    @property
    def parameter_count(self) -> int:
        """Number of the candidate's parameters, q."""
        return len(self.estimate)


@dataclass(frozen=True, kw_only=True)
class ScoreTable:
    """Scores of all candidates and the small matrices that everything after them is computed from.

    scores: in the order given. chi_square: rᵀ P r; degrees: N - rank of the Jacobian.
    joint_score: (Q,), joint_information: (Q, Q), all candidates' parameters one after the other, every
    tangent column in units of its own length and untestable directions removed. starts: (E + 1,) where each
    begins. bounded: (Q,). scale: (Q,) length of each tangent column.
    """

    scores: tuple[Score, ...]
    chi_square: float
    degrees: int
    sigma_known: bool
    joint_score: Array
    joint_information: Array
    starts: NDArray[np.int_]
    bounded: NDArray[np.bool_]
    scale: Array
    index: dict[str, int] = field(repr=False)

    def __getitem__(self, name: str) -> Score:
        return self.scores[self.index[name]]

    def columns(self, name: str) -> slice:
        """The candidate's place in the joint arrays."""
        position = self.index[name]
        return slice(int(self.starts[position]), int(self.starts[position + 1]))

    def ranked(self) -> tuple[Score, ...]:
        """Testable candidates, the largest drop after Akaike's penalty of 2 a parameter first.

        Unlike p-values the drop does not underflow when effects are strong.
        """
        tested = [score for score in self.scores if score.testable]
        return tuple(sorted(tested, key=lambda s: 2.0 * s.parameter_count - s.drop))
