"""The materials of a model fitted from the start, where they may lie in a minimum that is not theirs."""

from __future__ import annotations

from collections.abc import Callable

from mphygs.extend.finer import compared_again
from mphygs.extend.step import Step
from mphygs.extend.window import forget
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise, told
from mphygs.fit.schedule import find_scale
from mphygs.simulate.errors import SimulationError

# Of the frames, one after the other, on which materials begin anew.
SHARES, ITERATIONS = (0.25, 0.5, 1.0), 8


def anew(experiment: Experiment, step: Step, report: Callable[[str], None] | None = None) -> Step:
    """The step with its materials fitted from the start, where that lowers the cost.

    Those that were fitted beside an effect which is gone, without one that is there now, or on a grid that
    hardly carries thin parts, may lie in a minimum that was its own.
    """
    say = report or (lambda _text: None)
    try:
        belief = find_scale(experiment.window(step.spacing, SHARES[0]), forget(step.belief))
        for share in SHARES:
            solution = minimise(
                experiment.window(step.spacing, share),
                belief,
                iterations=ITERATIONS,
                relative_tolerance=1e-3,
                report=told(report, f"materials anew, {share:.0%} of the frames"),
            )
            belief = solution.belief
        gain = step.solution.evaluation.cost - solution.evaluation.cost
        say(f"materials anew: cost {step.solution.evaluation.cost:.6g} -> {solution.evaluation.cost:.6g}")
        if gain <= 0.0:
            return step
        compared = compared_again(experiment, step, belief)
    except SimulationError:
        return step
    assessment = experiment.assess(compared)
    after = step.refitted(solution, compared, assessment)
    # A closer fit that predicts worse is none.
    return after if after.explained >= step.explained else step
