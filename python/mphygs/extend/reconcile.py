"""Whether what a model misses of unseen frames is no more than what the fitted frames leave open.

A wall that was touched once says little of how it stands: where it is met a second time, in frames that were
not fitted, the prediction is off by far more than noise, and nothing is missing but a measurement. Such a
model explains all frames as soon as it may see them; one that lacks something does not. This is so where
something sets in at a moment (walls, yielding); smooth effects have no such excuse, and materials that may
see all frames would hide a weak one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from mphygs.compare.assess import BUDGET_FLOOR
from mphygs.extend.finer import lender_of
from mphygs.extend.setting_in import fit_what_sets_in
from mphygs.extend.step import EXPLAINED, Step
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import told
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
    return Experiment(experiment.capture, experiment.settings, fitted, experiment.observations)


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
    belief = step.belief
    say("fitting to all frames")
    try:
        for name in whole.fitted:
            belief = experiment.with_release(belief, name, step.spacing)
            whole.predictor(name, step.spacing)
        lender = lender_of(whole, step.spacing)
        problem = whole.problem(step.spacing)
        solution = fit_what_sets_in(
            problem, belief, iterations=ITERATIONS, lender=lender, report=told(report, "all frames")
        )
        compared = whole.compare(solution.belief, step.spacing, refine=True)
    except SimulationError:
        return step
    assessment = whole.assess(compared)
    enough = assessment.adequate or assessment.worst <= EXPLAINED
    meaning = "what was missed is what the fitted frames leave open" if enough else "something is missing"
    say(f"fitted to all frames: {assessment.worst:.3f} sigma, {meaning}")
    return replace(step, reconciled=enough)
