"""What a ranking of the effects that a model lacks says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mphygs.diagnose.decoys import DecoyCheck
from mphygs.diagnose.local_scores import Spot
from mphygs.diagnose.score_table import ScoreTable
from mphygs.model.belief import Belief
from mphygs.model.registry import effect

# Of tests, all candidates of a diagnosis together.
LEVEL = 0.01


@dataclass(frozen=True, eq=False)
class RankedEffect:
    """One effect in its best way.

    start: belief to refit from; others: beliefs that a refit starts from as well; statistic: predicted
    (trial: actual) drop of chi^2; stands_out: share of decoys at least as significant; detectable: of a
    parameter alone the smallest size that would have been found, in its unit; spots: where and when it is
    wanted most.
    """

    effect: str
    label: str
    kind: str
    statistic: float
    p_value: float
    expected_ratio: float
    estimate: dict[str, float]
    std: dict[str, float]
    start: Belief
    confounded_with: tuple[str, ...] = ()
    reason: str = ""
    detectable: Mapping[str, float] = field(default_factory=dict)
    stands_out: float | None = None
    others: tuple[Belief, ...] = ()
    spots: tuple[Spot, ...] = ()


@dataclass(frozen=True, eq=False)
class Ranking:
    """entries: best first, one per effect; chi_square, rows: of fitted frames; table: of all smooth ways;
    decoys: how effects that do nothing score on the same data; decoy_statistic: the largest drop of chi^2
    that one of them predicts; drift: fitted coordinates that would have to change for a while, and where."""

    entries: tuple[RankedEffect, ...]
    chi_square: float
    rows: int
    table: ScoreTable | None
    decoys: DecoyCheck | None = None
    decoy_statistic: float = 0.0
    drift: tuple[Spot, ...] = ()


def unsimulated(name: str, label: str, why: str, belief: Belief, misfit: float) -> RankedEffect:
    """An effect that cannot be simulated beside a model, with the reason. misfit: of that model [sigma]."""
    return RankedEffect(name, label, effect(name).kind, 0.0, 1.0, misfit, {}, {}, belief, reason=why)
