"""An effect that is another one with more numbers, held against that one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mphygs.extend.finer_grid import compared_as_step, fitted_by_coarse_jacobians
from mphygs.extend.nested_effects import at_short_time_limit, flow_numbers, without_flow, without_level
from mphygs.extend.step import Step, does_alike
from mphygs.extend.step_uncertainty import uncertainty
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

# In standard errors: further from zero than this, a parameter has been told from it.
TOLD = 3.0
ITERATIONS, REFITTED = 6, 1e-3


def with_simpler_effects(
    experiment: Experiment, step: Step, report: Callable[[str], None] | None = None
) -> Step:
    """The step with the simpler effect where that explains the motion too, the wider one tied with it.

    Asked of a model that explains the motion: what a grid has of its own, further numbers may take up. Where
    the simpler effect does not explain it, it is one of the ties if those numbers may all be zero: they do
    not tell the two apart.
    """
    if not step.explained:
        return step
    for wide in step.belief.effects:
        simple, limit = without_flow(wide), without_level(wide)
        effects = step.belief.effects
        known = {*step.ties, *effects} if limit else effects
        simple = simple or limit
        if simple is None or wide not in effects or simple in known:
            continue
        belief = _narrower(experiment, step.belief, wide, simple)
        if belief is None:
            continue
        after = _with(experiment, step, belief, wide, simple, report)
        if after is None or not after.explained or limit and not does_alike(after, step):
            if not limit and _untold(experiment, step, wide, flow_numbers(wide)):
                step = replace(step, ties=tuple(dict.fromkeys((*step.ties, simple))))
            continue
        if report:
            report(
                f"{wide}, {simple} with more numbers: {simple} explains the motion too, "
                f"{step.assessment.worst:.3f} -> {after.assessment.worst:.3f} sigma in the worst range"
            )
        step = after
    return step


def _untold(experiment: Experiment, step: Step, name: str, further: tuple[str, ...]) -> bool:
    """Whether all these parameters of an effect are within `TOLD` standard errors of zero."""
    std = np.sqrt(np.diag(uncertainty(step, experiment).covariance))
    told = {p.key: (p.coordinate, s) for p, s in zip(step.belief.free, std, strict=True)}
    keys = [f"{name}.{parameter}" for parameter in further]
    return all(key in told and abs(told[key][0]) <= TOLD * told[key][1] for key in keys)


def _with(
    experiment: Experiment,
    step: Step,
    belief: Belief,
    wide: str,
    simple: str,
    report: Callable[[str], None] | None,
) -> Step | None:
    """The step with `simple` in the place of `wide`, from a belief that has it; None where it is unstable."""
    ties = tuple(name for name in (wide, *step.ties) if name != simple)
    added = tuple(simple if name == wide else name for name in step.added)
    changes = {
        "added": added if simple in added else (*added, simple),
        "ties": tuple(dict.fromkeys(ties)),
        "dropped": (*step.dropped, wide),
    }
    try:
        if step.jacobian_spacing is not None:
            begun = replace(step, belief=belief)
            after = fitted_by_coarse_jacobians(experiment, begun, step.spacing, step.jacobian_spacing, report)
            return after and replace(after, **changes)
        solution = minimise(
            experiment.problem(step.spacing),
            belief,
            iterations=ITERATIONS,
            relative_tolerance=REFITTED,
        )
        compared = compared_as_step(experiment, step, solution.belief)
    except SimulationError:
        return None
    return step.refitted(solution, compared, experiment.assess(compared), **changes)


def _narrower(experiment: Experiment, belief: Belief, wide: str, simple: str) -> Belief | None:
    """The belief with `simple` in the place of `wide`, its parameters where those of the same name were; None
    where it is no limit of it there."""
    if without_level(wide):
        return at_short_time_limit(
            belief, wide, experiment.capture.sequence(next(iter(experiment.fitted))).fps
        )
    found = {p.key.rsplit(".", 1)[1]: p.value for p in belief.parameters if p.key.startswith(f"{wide}.")}
    kept = {p.name: found[p.name] for p in effect(simple).parameters if p.name in found}
    return belief.without_effect(wide).with_effect(simple, kept)
