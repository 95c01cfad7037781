"""One model of the loop, and how far it is from the floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mphygs.compare.assess import Assessment, Compared
from mphygs.diagnose.criteria import CRITERIA
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.model.belief import Belief

# The fault that bad tracks are left out for: no effect of the motion.
FAULT = "marker_outliers"


@dataclass(frozen=True, eq=False)
class Step:
    """One model of the loop. spacing: of its grid [m]; gain: of the feedback with which it stays near the
    data, where the next effect is looked for; added: effects new in it; ties: effects that the data
    cannot tell from them; dropped: effects of earlier steps that are superfluous with them; lender:
    spacing of the coarser grid that its Jacobians are of [m], None where they are its own; beside:
    spacing of the other grid that showed the discretisation's share, None for a finer one; moved: how
    far an ever finer grid would move each coordinate, by the parameter's key; table: one row a candidate
    that was held against it; warnings: what was said on the way to it."""

    belief: Belief
    solution: Solution
    compared: dict[str, Compared]
    assessment: Assessment
    spacing: float
    added: tuple[str, ...] = ()
    ties: tuple[str, ...] = ()
    dropped: tuple[str, ...] = ()
    lender: float | None = None
    beside: float | None = None
    moved: Mapping[str, float] = field(default_factory=dict)
    table: tuple[dict, ...] = ()
    warnings: tuple[str, ...] = ()
    gain: float = 1.0

    @property
    def explained(self) -> bool:
        """Whether the error is at its floor: adequate by the test, or a misfit that is negligible
        everywhere."""
        return self.assessment.adequate or self.assessment.worst <= CRITERIA.negligible


def from_grid_to_grid(coarse: Belief, fine: Belief, ratio: float) -> dict[str, float]:
    """How far coordinates are from where an ever finer grid would lead, by the parameter's key: their change
    over ratio^2 - 1, the ratio of the spacings (Richardson, second order). What stood at a bound says
    nothing."""
    if ratio <= 1.0:
        return {}
    before = {p.key: p for p in coarse.free}
    return {
        p.key: (p.coordinate - before[p.key].coordinate) / (ratio**2 - 1.0)
        for p in fine.free
        if p.key in before and not (p.at_bound or before[p.key].at_bound)
    }


def known_budget(step: Step) -> bool:
    """Whether a refinement of the step's model has been run."""
    return any(item.refinement is not None for item in step.compared.values())


def excess(assessment: Assessment, label: str | None = None) -> float:
    """Mean square beyond noise of the whitened residual, averaged over ranges, or over those of a label."""
    items = [item for ranges in assessment.ratio.values() for item in ranges.items()]
    values = [value for key, value in items if label in (None, key)]
    return float(np.mean([max(v * v - 1.0, 0.0) for v in values]))


def with_warnings(step: Step, *texts: str) -> Step:
    """The step with more said of it."""
    return replace(step, warnings=(*step.warnings, *texts))
