"""What a later effect made superfluous is taken out again."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from mphygs.extend.step import Step, does_alike
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.simulate.errors import SimulationError

ITERATIONS = 8


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
        without = replace(
            step,
            belief=solution.belief,
            solution=solution,
            compared=compared,
            assessment=assessment,
            dropped=(*step.dropped, name),
        )
        say(f"without {name}: {step.assessment.worst:.3f} -> {assessment.worst:.3f} sigma in the worst range")
        if does_alike(without, step) and without.explained >= step.explained:
            step = without
    return step
