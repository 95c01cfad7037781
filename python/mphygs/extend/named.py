"""Add effects by name to a fitted model and refit, from where the fit ended."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mphygs.diagnose.criteria import CRITERIA
from mphygs.diagnose.propose import proposals
from mphygs.diagnose.scan import scan
from mphygs.extend.contend import FAILURES, contenders, gain_of, predictive
from mphygs.extend.discover import mask_outliers
from mphygs.extend.rounds import assimilated
from mphygs.extend.step import Step
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise, told
from mphygs.fit.placement import with_placed_effect
from mphygs.fit.schedule import screening_spacing
from mphygs.model.belief import Belief
from mphygs.model.registry import effect

FAULT = "marker_outliers"
ITERATIONS = 12


def add_named(
    experiment: Experiment,
    before: Step,
    name: str,
    spacing: float,
    *,
    seed: tuple[int, ...] = (0,),
    report: Callable[[str], None] | None = None,
) -> tuple[Step, bool]:
    """One effect, or one fault of the measurement, more in the model.

    Where it needs a place, a direction or a first value, the residual chooses the best. Returns the step and
    whether it pays on frames that were not fitted.
    Raises KeyError for an unknown effect, ValueError for one that is in the model or that changes nothing.
    """
    spec = effect(name)
    if name in before.belief.effects or (name == "prestress" and before.belief.prestress == "equilibrium"):
        raise ValueError(f"effect '{name}' is in the model already; expected another one")
    if name == FAULT:
        left_out = mask_outliers(experiment, before.compared)
        if report:
            report(f"{left_out} measurements do not move with their neighbours: left out")
        experiment.problems.clear()
        return _refitted(experiment, before, [before.belief], name, spacing, report)
    if name == "prestress":
        return _refitted(experiment, before, [before.belief.with_effect(name)], name, spacing, report)
    starts = _starts(experiment, before, name, spacing, seed, report)
    if not starts and spec.kind == "threshold":
        raise ValueError(f"effect '{name}': no trial of it acts in this motion; expected another effect")
    if not starts:
        placed = with_placed_effect(before.belief, name, experiment.capture, tuple(experiment.fitted))
        starts = [placed]
    return _refitted(experiment, before, starts, name, spacing, report)


def _starts(
    experiment: Experiment,
    before: Step,
    name: str,
    spacing: float,
    seed: tuple[int, ...],
    report: Callable[[str], None] | None,
) -> list[Belief]:
    """Beliefs with the effect where scores beside the measurement put it, on a grid for trying; the materials
    as they were fitted there."""
    coarse = max(spacing, screening_spacing(experiment.capture))
    say = report or (lambda _text: None)
    beside = assimilated(experiment, before.belief, coarse, say=say)
    problem = experiment.problem(coarse).under(beside.gain)
    ways, trials = proposals(experiment, problem, beside.belief, beside.solution.evaluation, names=(name,))
    if not ways and not trials:
        return []
    found = scan(
        experiment, problem, beside.belief, beside.solution.evaluation, ways, trials,
        generator=np.random.default_rng(seed), report=report,
    )  # fmt: skip
    best = [s for s in found.by_effect() if s.struck is None and s.start is not None]
    if not best:
        return []
    tried = contenders(experiment, coarse, beside.gain, beside.solution, best, report=report)
    return [t.solution.belief for t in tried if t.struck is None] or [s.start for s in best]


def _refitted(
    experiment: Experiment,
    before: Step,
    starts: list[Belief],
    name: str,
    spacing: float,
    report: Callable[[str], None] | None,
) -> tuple[Step, bool]:
    """A step from the best of some beliefs, and whether it pays. Raises ValueError where none can be
    simulated."""
    problem, found, why = experiment.problem(spacing), None, ""
    for start in starts:
        try:
            solution: Solution = minimise(
                problem, start, iterations=ITERATIONS, report=told(report, f"with {name}")
            )
        except FAILURES as error:
            why = str(error).splitlines()[0]
            continue
        if found is None or solution.evaluation.cost < found.evaluation.cost:
            found = solution
    if found is None:
        raise ValueError(f"effect '{name}': the model with it cannot be simulated from its estimate: {why}")
    compared = experiment.compare(found.belief, spacing)
    step = Step(found.belief, found, compared, experiment.assess(compared), spacing, (name,))
    if name == FAULT:
        # Other measurements are used now: likelihoods before and after are not of the same data.
        return step, step.assessment.worst < before.assessment.worst
    scale = max(found.evaluation.misfit**2, 1.0)
    gain, error = gain_of(predictive(before.compared), predictive(compared), scale)
    paying = gain > 0.0 and (gain > CRITERIA.tied * error or not np.isfinite(error))
    if not paying and before.compared.keys() == compared.keys():
        drop = before.solution.evaluation.chi_square - found.evaluation.chi_square
        mostly = found.evaluation.chi_square < MOSTLY * (found.evaluation.chi_square + drop)
        paying = gain > 0.0 and mostly
    return replace(step, warnings=before.warnings), paying


# Of chi^2 on the fitted frames: what leaves no more pays without a clear gain on unseen ones, too.
MOSTLY = 0.25
