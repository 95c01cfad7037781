"""One model of the loop, and how far it is from the floor."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from mphygs.compare.assess import Assessment, Compared, ratios_at_zero_spacing, stays
from mphygs.extend.refit import Refit
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.limits import Limits
from mphygs.fit.uncertainty import grid_change
from mphygs.model.belief import Belief
from mphygs.model.registry import outliers

# The error counts as explained below this many sigma on every range.
EXPLAINED = 1.1
# An effect that leaves less than this share of the excess explains most.
LARGELY = 0.5
# The fault that bad tracks are left out for: no effect of the motion.
FAULT = outliers()
# An effect that leaves this share of another's excess on all frames explains more; excesses that differ by
# less than the second number [of the noise's mean square] are the same.
CLEARLY_BETTER, NEGLIGIBLE = 0.8, 0.02


@dataclass(frozen=True, eq=False)
class Step:
    """One model of the loop. spacing: of its grid [m]; added: effects new in it; ties: effects that the data
    cannot tell from them; window_share: share of the fitted frames, from the first on, that they were found
    on; dropped: effects of earlier steps that are superfluous with them; reconciled: whether the same model,
    fitted to all frames, explains them all; jacobian_spacing: spacing of the coarser grid that its Jacobians
    are of [m], None where they are its own; refinement_spacing: spacing of the coarser grid that showed the
    discretisation's share, where one was asked [m], None for a finer one; moved: how far the next finer grid
    would move each coordinate, by the parameter's key, as the last change of grids tells (see
    `from_grid_to_grid`); coarse_belief: the model as it had been fitted on the coarser grid that it was
    brought from; halfway: of a first model, as it had been fitted to half the frames on this grid; persists:
    whether its misfit did on the step from a coarser grid to this one (see `beside_coarser`); excess_beyond:
    its excess in the limit of zero spacing, as that step tells, None where there was none; warnings: what was
    said on the way to it; limits: how far its numbers can be moved, None where that was not asked (see
    `bounded`), and with it change: (N,) error of the grid in the measured rows, by a coarser one; table: the
    candidates of the round that led to it (see `candidate_rows`)."""

    belief: Belief
    solution: Solution
    compared: dict[str, Compared]
    assessment: Assessment
    spacing: float
    added: tuple[str, ...] = ()
    ties: tuple[str, ...] = ()
    refits: tuple[Refit, ...] = ()
    window_share: float = 1.0
    dropped: tuple[str, ...] = ()
    reconciled: bool = False
    jacobian_spacing: float | None = None
    refinement_spacing: float | None = None
    moved: Mapping[str, float] = field(default_factory=dict)
    coarse_belief: Belief | None = None
    halfway: Belief | None = None
    warnings: tuple[str, ...] = ()
    persists: bool = False
    excess_beyond: float | None = None
    limits: Mapping[str, Limits] | None = None
    change: np.ndarray | None = None
    table: tuple[dict[str, object], ...] = ()

    def refitted(
        self, solution: Solution, compared: dict[str, Compared], assessment: Assessment, **changes: object
    ) -> Step:
        """The step with its model fitted anew; what was asked of it before does not hold any more.
        changes: to its other fields."""
        return replace(
            self,
            belief=solution.belief,
            solution=solution,
            compared=compared,
            assessment=assessment,
            **({"limits": None, "change": None, "excess_beyond": None} | changes),
        )

    @property
    def stays(self) -> bool:
        """Whether a finer grid has been seen to leave its misfit as it is."""
        return any(item.stays for item in self.compared.values())

    @property
    def explained(self) -> bool:
        """Whether the error is at its floor; without any effect added, whether the model needs none."""
        near = bool(self.added) and self.assessment.worst <= EXPLAINED
        return self.assessment.adequate or near or self.reconciled


def staying(compared: Mapping[str, Compared]) -> dict[str, Compared]:
    """A comparison of which a finer grid has been seen to leave the misfit as it is."""
    return {name: replace(item, stays=True) for name, item in compared.items()}


def beside_coarser(
    experiment: Experiment,
    step: Step,
    compared: dict[str, Compared],
    spacing: float,
    say: Callable[[str], None],
) -> tuple[dict[str, Compared], Assessment, dict[str, object]]:
    """A step's model, fitted on a grid of another spacing [m] and compared there; what that says, and where
    it is finer, whether it leaves as much (see `stays`) and what a finer one yet would: `persists` and
    `excess_beyond` of `Step`.

    No grid excuses what two finer ones in a row leave: on one step alone grids may both be too coarse to
    converge, for a thin leaf, say.
    """
    assessment = experiment.assess(compared)
    said = f"{step.assessment.worst:.3f} -> {assessment.worst:.3f} sigma in the worst range"
    ratio = step.spacing / spacing
    persists = ratio > 1.0 and stays(step.assessment, assessment, ratio)
    beyond = None
    if ratio > 1.0:
        beyond = excess_of(ratios_at_zero_spacing(step.compared, compared, ratio))
    if persists and step.persists:
        compared = staying(compared)
        assessment = experiment.assess(compared)
        said += ", which is not the grid's then"
    say(said)
    return compared, assessment, {"persists": persists, "excess_beyond": beyond}


def from_grid_to_grid(step: Step, fitted: Belief, spacing: float) -> dict[str, float]:
    """How far coordinates are from where an ever finer grid would lead, by the parameter's key.

    A model's numbers were fitted on the grid of `step` and are fitted on a finer one of `spacing` [m] now, as
    `fitted` (see `grid_change`). What did not change, or stood at a bound on either grid, says nothing.
    """
    ratio = step.spacing / spacing
    if ratio <= 1.0:
        return {}
    change = grid_change(step.belief, fitted, ratio)
    return {p.key: float(c) for p, c in zip(fitted.free, change, strict=True) if c}


def known_budget(step: Step) -> bool:
    """Whether a refinement of the step's model has been run."""
    return any(item.refinement is not None for item in step.compared.values())


def excess(assessment: Assessment, label: str | None = None) -> float:
    """Mean square beyond noise of the whitened residual, averaged over ranges, or over those of a label."""
    return excess_of(assessment.ratio, label)


def excess_of(ratio: Mapping[str, Mapping[str, float]], label: str | None = None) -> float:
    """The same of ratios by sequence and range."""
    items = [item for ranges in ratio.values() for item in ranges.items()]
    values = [value for key, value in items if label in (None, key)]
    return float(np.mean([max(v * v - 1.0, 0.0) for v in values]))


def leaves_most(steps: Sequence[Step]) -> bool:
    """Whether the last step, of a second effect or a later one, leaves most of what was left before it."""
    effects = [step for step in steps if set(step.added) - {FAULT}]
    if len(effects) < 2 or effects[-1] is not steps[-1]:
        return False
    return excess(steps[-1].assessment) > LARGELY * excess(steps[-2].assessment)


def excess_on_its_grid(step: Step) -> float:
    """What a step leaves (see `excess`) on the grid that it stands on."""
    return excess(step.assessment)


def does_alike(
    rival: Step,
    best: Step,
    *,
    share: float = CLEARLY_BETTER,
    left: Callable[[Step], float] = excess_on_its_grid,
) -> bool:
    """Whether a rival explains as much as the best; every parameter that the best has more has to pay.

    share: of the rival's excess that a better one would leave; left: the excess of a step.
    """
    more = max(best.belief.numbers - rival.belief.numbers, 0)
    return left(rival) < left(best) / share + NEGLIGIBLE * (1 + more)
