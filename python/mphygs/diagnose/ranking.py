"""What a ranking of the effects that a model lacks says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mphygs.diagnose.scan import Scan
from mphygs.diagnose.score_table import ScoreTable
from mphygs.diagnose.spots import Spot
from mphygs.model.belief import Belief

# Of tests, all candidates of a diagnosis together.
LEVEL = 0.01


@dataclass(frozen=True, eq=False)
class Entry:
    """One effect in its best way.

    start: belief to refit from; others: beliefs that a refit starts from as well; statistic: predicted
    (trial: actual) drop of chi^2; detectable: of a
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
    others: tuple[Belief, ...] = ()
    spots: tuple[Spot, ...] = ()


@dataclass(frozen=True, eq=False)
class Ranking:
    """entries: best first, one per effect; chi_square, rows: of fitted frames; table: of all smooth ways;
    drift: fitted coordinates that would have to change for a while, and where."""

    entries: tuple[Entry, ...]
    chi_square: float
    rows: int
    table: ScoreTable | None
    drift: tuple[Spot, ...] = ()


def ranking_of(scan: Scan, belief: Belief) -> Ranking:
    """A scan as a ranking: one entry an effect, the best first."""
    entries = [
        Entry(
            s.effect,
            s.label,
            s.kind,
            max(s.drop, 0.0),
            s.p_value if np.isfinite(s.p_value) else 1.0,
            float(np.sqrt(max(scan.chi_square - s.drop, 0.0) / max(scan.rows, 1))),
            dict(s.estimate),
            dict(s.std),
            s.start or belief,
            s.alike,
            reason=s.struck or "",
            detectable=s.detectable,
            spots=() if s.tangent is None else scan.spots.of_columns(s.tangent, s.labels),
        )
        for s in scan.by_effect()
    ]
    return Ranking(tuple(entries), scan.chi_square, scan.rows, scan.table, scan.drift)
