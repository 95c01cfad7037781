"""What a later effect made superfluous is taken out again."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mphygs.extend.step import Step, does_alike, known_budget
from mphygs.extend.window import forget
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.fit.schedule import find_scale
from mphygs.simulate.errors import SimulationError

ITERATIONS = 8
# Of the frames, one after the other, on which materials begin anew.
SHARES = (0.25, 0.5, 1.0)


def pruned(
    experiment: Experiment,
    step: Step,
    earlier: Sequence[str],
    report: Callable[[str], None] | None = None,
) -> Step:
    """The step without those effects of earlier steps that it does as well without.

    Where one of two causes is found first in the guise of the other, the loop has both in the end.
    """
    say = report or (lambda _text: None)
    for name in earlier:
        if name not in step.belief.effects or name in step.added:
            continue
        try:
            problem = experiment.problem(step.spacing)
            belief = step.belief.without_effect(name)
            solution = minimise(problem, belief, iterations=ITERATIONS, relative_tolerance=1e-3)
            compared = experiment.compare(solution.belief, step.spacing)
        except SimulationError:
            continue
        assessment = experiment.assess(compared)
        without = step.refitted(solution, compared, assessment, dropped=(*step.dropped, name))
        say(f"without {name}: {step.assessment.worst:.3f} -> {assessment.worst:.3f} sigma in the worst range")
        if does_alike(without, step) and without.explained >= step.explained:
            step = anew(experiment, without, report)
    return step


def anew(experiment: Experiment, step: Step, report: Callable[[str], None] | None = None) -> Step:
    """The step with its materials fitted from the start, where that lowers the cost.

    Those that were fitted beside an effect which is gone may lie in a minimum that was its own.
    """
    say = report or (lambda _text: None)
    try:
        belief = find_scale(experiment.window(step.spacing, SHARES[0]), forget(step.belief))
        for share in SHARES:
            solution = minimise(
                experiment.window(step.spacing, share), belief, iterations=ITERATIONS, relative_tolerance=1e-3
            )
            belief = solution.belief
        gain = step.solution.evaluation.cost - solution.evaluation.cost
        say(f"materials anew: cost {step.solution.evaluation.cost:.6g} -> {solution.evaluation.cost:.6g}")
        if gain <= 0.0:
            return step
        compared = experiment.compare(belief, step.spacing, refine=known_budget(step))
    except SimulationError:
        return step
    assessment = experiment.assess(compared)
    after = step.refitted(solution, compared, assessment)
    # A closer fit that predicts worse is none.
    return after if after.explained >= step.explained else step
