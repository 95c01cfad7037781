"""Effects the data cannot tell apart, and the motion that would.

For single unbounded parameters what f leaves of e is S_e (1 - C²), C = j_eᵀ P j_f / sqrt(I_e I_f). In general
it is the gain of e's estimate minus the most that f, within its own bounds, gains on data made by that
estimate.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mphygs.diagnose.cone import cone_maximum
from mphygs.diagnose.score_table import ScoreTable

Array = NDArray[np.float64]

# Less than three standard deviations left.
TIE_BELOW = 9.0


@dataclass(frozen=True, kw_only=True)
class Tie:
    """How well a leading effect is told from a rival.

    correlation: largest canonical correlation of their tangents, |C| for single parameters.
    expected: what the rival would leave of the leader's drop, were the leader the truth.
    observed: what the leader still gains on these data once the rival is in.
    """

    leader: str
    rival: str
    correlation: float
    expected: float
    observed: float

    @property
    def remaining(self) -> float:
        """The smaller of the two readings."""
        return min(self.expected, self.observed)


def compare_pair(table: ScoreTable, leader: str, rival: str) -> Tie:
    """Both readings of what sets leader and rival apart. Raises KeyError on a name not in the table."""
    first, second = table.columns(leader), table.columns(rival)
    information, score, bounded = table.joint_information, table.joint_score, table.bounded
    gains, estimates, _ = cone_maximum(score[None, first], information[first, first], bounded[first])
    pair = np.r_[first, second]
    together, _, _ = cone_maximum(score[None, pair], information[np.ix_(pair, pair)], bounded[pair])
    alone, _, _ = cone_maximum(score[None, second], information[second, second], bounded[second])
    return Tie(
        leader=leader,
        rival=rival,
        correlation=_canonical_correlation(
            information[first, first], information[first, second], information[second, second]
        ),
        expected=_left_by(table, first, second, estimates[0], float(gains[0])),
        observed=max(float(together[0] - alone[0]), 0.0),
    )


def tied_with(table: ScoreTable, leader: str, *, below: float = TIE_BELOW) -> tuple[Tie, ...]:
    """Rivals that leave less than `below` of the leader, the closest first."""
    pairs = [compare_pair(table, leader, s.name) for s in table.scores if s.testable and s.name != leader]
    return tuple(sorted((p for p in pairs if p.remaining < below), key=lambda p: p.remaining))


def separation(table: ScoreTable, leader: str, rival: str, *, increment: Array) -> float:
    """Drop of chi² that would tell the leader from the rival in the motion behind `table`.

    increment: (q,) strength of the leader, in its own units. The table may be of a motion not yet recorded
    (residual zero): only its information is used.
    """
    place = table.columns(leader)
    scaled = np.asarray(increment, dtype=float) * table.scale[place]
    gain = float(scaled @ table.joint_information[place, place] @ scaled)
    return _left_by(table, place, table.columns(rival), scaled, gain)


def separating_motions(
    tables: Mapping[str, ScoreTable], leader: str, rival: str, *, increment: Array
) -> tuple[tuple[str, float], ...]:
    """Candidate motions by name with their separation of the pair, the best first."""
    found = [(name, separation(table, leader, rival, increment=increment)) for name, table in tables.items()]
    return tuple(sorted(found, key=lambda item: -item[1]))


def _left_by(table: ScoreTable, first: slice, second: slice, increment: Array, gain: float) -> float:
    information = table.joint_information
    induced = information[second, first] @ increment
    explained, _, _ = cone_maximum(induced[None], information[second, second], table.bounded[second])
    return max(gain - float(explained[0]), 0.0)


def _canonical_correlation(first: Array, cross: Array, second: Array) -> float:
    singular = np.linalg.svd(_inverse_root(first) @ cross @ _inverse_root(second), compute_uv=False)
    return float(min(singular.max(initial=0.0), 1.0))


def _inverse_root(matrix: Array) -> Array:
    values, vectors = np.linalg.eigh(matrix)
    kept = values > 1e-10 * max(float(values.max()), np.finfo(float).tiny)
    return (vectors[:, kept] / np.sqrt(values[kept])) @ vectors[:, kept].T
