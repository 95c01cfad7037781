"""Whether what a model misses of unseen frames is no more than what the fitted frames leave open.

A wall that was touched once says little of how it stands: where it is met a second time, in frames that were
not fitted, the prediction is off by far more than noise, and nothing is missing but a measurement. Such a
model explains all frames as soon as it may see them; one that lacks something does not. This is so where
something sets in at a moment (walls, yielding); smooth effects have no such excuse, and materials that may
see all frames would hide a weak one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from mphygs.compare.assess import BUDGET_FLOOR
from mphygs.extend.finer_grid import jacobian_source, with_tangents
from mphygs.extend.onset_fit import with_onset_fitted
from mphygs.extend.step import EXPLAINED, Step
from mphygs.fit.borrowed_jacobians import approached
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise, report_of_iterations
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

# Worth asking while the fitted frames are this near to the floor.
NEAR = EXPLAINED * BUDGET_FLOOR
ITERATIONS = 5


def on_all_frames(experiment: Experiment) -> Experiment:
    """The experiment with every compared frame among the fitted ones."""
    fitted = {}
    for name in experiment.compared_names():
        spans = [s for s in (experiment.fitted.get(name), experiment.unseen(name)) if s and s[1] > s[0]]
        fitted[name] = (min(a for a, _ in spans), max(b for _, b in spans))
    known = (experiment.capture, experiment.settings, fitted, experiment.observations)
    return Experiment(*known, reference=experiment.reference)


def reconciled(experiment: Experiment, step: Step, report: Callable[[str], None] | None = None) -> Step:
    """The step, marked where the same model explains all frames once it is fitted to all of them.

    Its numbers stay those of the fitted frames.
    """
    near = all(ranges.get("fit", 1.0) <= NEAR for ranges in step.assessment.ratio.values())
    sets_in = any(effect(name).kind == "threshold" for name in step.belief.effects)
    if step.explained or not near or not sets_in:
        return step
    say = report or (lambda _text: None)
    whole = on_all_frames(experiment)
    belief, tell = step.belief, report_of_iterations(report, "all frames")
    say("fitting to all frames")
    try:
        for name in whole.fitted:
            belief = experiment.with_release(belief, name, step.spacing)
            whole.predictor(name, step.spacing)
        jacobian_problem = jacobian_source(whole, step.spacing)
        problem, worst, enough = whole.problem(step.spacing), math.inf, False
        if jacobian_problem is not None:
            # The coarse grid's Jacobians, at a fraction of the work, may be enough to say so.
            belief = with_onset_fitted(problem, belief, jacobian_problem=jacobian_problem, report=tell)
            belief = approached(problem, jacobian_problem, belief, iterations=ITERATIONS, report=tell)
            worst, enough = _judged(whole, belief, step.spacing)
        if not enough:
            if jacobian_problem is None:
                belief = with_onset_fitted(problem, belief, report=tell)
            solution = minimise(problem, belief, iterations=ITERATIONS, relative_tolerance=1e-3, report=tell)
            worst, enough = _judged(whole, solution.belief, step.spacing)
    except SimulationError:
        return step
    meaning = "what was missed is what the fitted frames leave open" if enough else "something is missing"
    say(f"fitted to all frames: {worst:.3f} sigma, {meaning}")
    return replace(step, reconciled=enough)


def _judged(whole: Experiment, belief: Belief, spacing: float) -> tuple[float, bool]:
    """The largest misfit of any range [sigma], and whether it is explained. Raises SimulationError."""
    compared = whole.compare(belief, spacing, jacobian=False)
    compared = whole.with_refinement(compared, belief, spacing)
    assessment = whole.assess(with_tangents(whole, compared, belief, spacing))
    return assessment.worst, assessment.adequate or assessment.worst <= EXPLAINED
