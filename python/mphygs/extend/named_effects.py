"""Add effects by name to a fitted model and refit, from where the fit ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mphygs.diagnose.rank import rank
from mphygs.extend.discovery import mask_outliers
from mphygs.extend.finer_grid import jacobian_source
from mphygs.extend.first_fit import first_fit
from mphygs.extend.refit import finish_refit, unseen_gain
from mphygs.extend.refit_beginning import start_refit
from mphygs.extend.step import Step
from mphygs.fit.experiment import Experiment
from mphygs.fit.placement import with_placed_effect
from mphygs.model.belief import Belief
from mphygs.model.registry import effect


def _started(belief: Belief, name: str, experiment: Experiment) -> Belief:
    return with_placed_effect(belief, name, experiment.capture, tuple(experiment.fitted))


def add_effect(
    experiment: Experiment,
    before: Step,
    name: str,
    spacing: float,
    *,
    generator: np.random.Generator,
    report: Callable[[str], None] | None = None,
) -> tuple[Step, bool]:
    """One effect, or one fault of the measurement, more in the model.

    Where it needs a place, a direction or a first value, the residual chooses the best. Returns the step and
    whether it pays on frames that were not fitted.
    Raises KeyError for an unknown effect, ValueError for one that is in the model or that changes nothing.
    """
    spec = effect(name)
    carried = spec.carries_gravity and before.belief.prestress == "equilibrium"
    if carried or name in (*before.belief.effects, before.belief.law):
        raise ValueError(f"effect '{name}' is in the model already; expected another one")
    if spec.fault and not spec.fitted and not spec.leaves_out:
        raise ValueError(f"effect '{name}' is seen in the tracks alone, and put right when they are read")
    if spec.leaves_out:
        left_out = mask_outliers(experiment, before.compared)
        if report:
            report(f"{left_out} measurements do not move with their neighbours: left out")
        experiment.problems.clear()
        return _refitted(experiment, before, before.belief, name, spacing, generator, report)
    if spec.carries_gravity:
        return _refitted(
            experiment, before, before.belief.with_effect(name), name, spacing, generator, report
        )
    ranking = rank(
        experiment,
        before.belief,
        before.solution.evaluation,
        spacing,
        generator=generator,
        names=(name,),
        report=report,
    )
    entry = next((e for e in ranking.entries if e.effect == name and name in e.start.effects), None)
    if entry is None and spec.kind == "threshold":
        raise ValueError(f"effect '{name}': no trial of it acts in this motion; expected another effect")
    if entry is None:
        return _refitted(
            experiment, before, _started(before.belief, name, experiment), name, spacing, generator, report
        )
    jacobian_problem = jacobian_source(experiment, spacing)
    begun = start_refit(
        experiment, before.solution, entry, spacing, jacobian_problem=jacobian_problem, report=report
    )
    found = None
    if begun is not None:
        found = finish_refit(
            experiment,
            before.solution,
            before.compared,
            entry,
            begun,
            spacing,
            generator=generator,
            report=report,
        )
    if found is None:
        raise ValueError(f"effect '{name}': the model with it cannot be simulated from its estimate")
    step = Step(
        found.belief,
        found.solution,
        found.compared,
        found.assessment,
        spacing,
        (name,),
        entry.confounded_with,
        (found,),
    )
    return step, found.pays


def _refitted(
    experiment: Experiment,
    before: Step,
    belief: Belief,
    name: str,
    spacing: float,
    generator: np.random.Generator,
    report: Callable[[str], None] | None,
) -> tuple[Step, bool]:
    """A step from a belief near its minimum, and whether it pays."""
    after = first_fit(experiment, belief, spacing, report=report, warm=True)
    step = replace(after, added=(name,))
    if effect(name).leaves_out:
        # Other measurements are used now: likelihoods before and after are not of the same data.
        return step, step.assessment.worst < before.assessment.worst
    gain = unseen_gain(before.compared, after.compared, generator)
    drop = before.solution.evaluation.chi_square - after.solution.evaluation.chi_square
    return step, gain.accepted if gain is not None else drop > 20.0
