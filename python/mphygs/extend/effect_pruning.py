"""What a later effect made superfluous is taken out again."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from mphygs.extend.finer_grid import jacobian_source
from mphygs.extend.grids import complete
from mphygs.extend.step import NEGLIGIBLE, Step, does_alike
from mphygs.fit.borrowed_jacobians import approached
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise, report_of_iterations
from mphygs.fit.problem import Evaluation
from mphygs.simulate.errors import SimulationError

# Of a fit without an effect; after the first few one that is far off is given up: whose excess over noise is
# so many times what would do as well, and so many times where only the coarse grid's Jacobians have led.
ITERATIONS, FIRST = 8, 2
FAR, FAR_FROM_AFAR = 2.0, 4.0
# An effect that lowers the excess to this share is needed: what is in the model has been paid for.
NEEDED = 0.95


def with_effects_pruned(
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
            jacobian_problem, tell = (
                jacobian_source(experiment, step.spacing),
                report_of_iterations(report, f"without {name}"),
            )
            if jacobian_problem is not None:
                # So far Jacobians of the coarse grid lead, at a fraction of the work.
                belief = approached(problem, jacobian_problem, belief, report=tell)
                reached = problem.evaluate(belief, jacobian=False)
                if _far(reached, step.solution.evaluation, FAR_FROM_AFAR):
                    say(f"without {name}: {reached.misfit:.3f} sigma, given up")
                    continue
            solution = minimise(problem, belief, iterations=FIRST, relative_tolerance=1e-3, report=tell)
            if _far(solution.evaluation, step.solution.evaluation, FAR):
                say(f"without {name}: {solution.evaluation.misfit:.3f} sigma, given up")
                continue
            if not solution.converged:
                left = ITERATIONS - FIRST
                solution = minimise(
                    problem, solution.belief, iterations=left, relative_tolerance=1e-3, report=tell
                )
            compared = experiment.compare(solution.belief, step.spacing, jacobian=False)
        except SimulationError:
            continue
        assessment = experiment.assess(compared)
        without = step.refitted(solution, compared, assessment, dropped=(*step.dropped, name))
        say(f"without {name}: {step.assessment.worst:.3f} -> {assessment.worst:.3f} sigma in the worst range")
        if not does_alike(without, step, share=NEEDED):
            continue
        without = complete(experiment, without)
        if without.explained >= step.explained:
            step = without
    return step


def _far(without: Evaluation, step: Evaluation, far: float) -> bool:
    """Whether a fit that is not at its end yet will not do as well as the step's: its excess over noise is so
    many times what would do."""
    enough = max(step.misfit**2 - 1.0, 0.0) / NEEDED + NEGLIGIBLE
    return without.misfit**2 - 1.0 > far * enough
