"""Which grid a model stands on: coarse while the misfit is gross, finer where it could be the grid's own."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from mphygs.compare.assess import LARGEST_EXCUSED, LARGEST_GRID_ERROR
from mphygs.extend.finer_grid import (
    LENDS,
    best_fitting,
    compared_as_step,
    jacobian_source,
    on_finer_grid,
    with_tangents,
)
from mphygs.extend.onset_transfer import onset_on_grid
from mphygs.extend.refit import AT_FLOOR, NEAR_FLOOR
from mphygs.extend.step import (
    EXPLAINED,
    Step,
    beside_coarser,
    from_grid_to_grid,
    known_budget,
)
from mphygs.fit.borrowed_jacobians import approached
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise, report_of_iterations
from mphygs.fit.place_fit import relocated
from mphygs.fit.problem import Problem
from mphygs.fit.spacings import deciding_spacing, default_spacing
from mphygs.fit.stiffness_scale import simulable, without_stiffest
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

# On the screening grid a misfit [sigma] below the first number, or an excess below this share of that of the
# first model, may be the grid's own: the deciding grid is asked.
GROSS, EXPLAINED_ON_COARSE = 3.0, 0.1
# Of a refit on another grid; a misfit that is gross after the first few is not the grid's.
ITERATIONS, FIRST = 8, 3
# What is left is not the grid's where it is so many times what a coarser grid shows of that, and above so
# many sigma: less than that the floor test, which a rough share misleads, may excuse. Before a fit is at its
# end so many times more; so many times where it hardly falls any further.
BEYOND, CLEAR, FURTHER = 3.0, 1.5, 2.0
# Share of the cost that the last step of what is concluded may promise, and of what is not near the floor.
LAST_DIGITS, ROUGHLY = 1e-5, 1e-2


def has_onset(step: Step) -> bool:
    """Whether the last effect of a step is one that sets in at some moment: a wall, yielding."""
    return any(effect(name).kind == "threshold" for name in step.added)


def on_grid(
    experiment: Experiment,
    step: Step,
    spacing: float,
    report: Callable[[str], None] | None = None,
    *,
    hopeless: float = math.inf,
    tangents: bool = True,
) -> Step | None:
    """The step refitted on another grid, None where it cannot be simulated there.

    hopeless: misfit [sigma] of the fitted frames above which it is given up after the first iterations;
    tangents: whether it may be concluded from (see `complete`).

    What sets in at some moment is refitted from there on (see `followed`): over all frames at once, what a
    coarse grid made of it is hard to leave.
    """
    say = report or (lambda _text: None)
    say(f"refitting on a grid of {1e3 * spacing:.3g} mm")
    try:
        problem = experiment.problem(spacing)
        belief = simulable(problem, step.belief)
        softer = without_stiffest(belief) if spacing < step.spacing else None
        if softer is not None:
            belief = best_fitting(problem, (belief, softer))
        tell = report_of_iterations(report, f"{1e3 * spacing:.3g} mm")
        jacobian_problem = jacobian_source(experiment, spacing)
        if step.window_share < 1.0 and has_onset(step):
            belief = onset_on_grid(experiment, belief, step.window_share, jacobian_problem, spacing, tell)
        if jacobian_problem is not None:
            belief = approached(problem, jacobian_problem, belief)
        solution = minimise(problem, belief, iterations=FIRST, relative_tolerance=1e-3, report=tell)
        misfit = solution.evaluation.misfit
        if misfit > hopeless:
            say(f"{', '.join(step.added)}: given up, others leave less")
            return None
        beyond = misfit > GROSS or _out_of_reach(experiment, step, solution, spacing)
        if not solution.converged and not beyond:
            # Where and how hard something is met, to the last digits, is the grid's.
            far = misfit >= NEAR_FLOOR or has_onset(step)
            left, accuracy = ITERATIONS - FIRST, ROUGHLY if far else 1e-3
            solution = minimise(
                problem, solution.belief, iterations=left, relative_tolerance=accuracy, least=accuracy,
                report=tell,
            )  # fmt: skip
        compared = experiment.compare(solution.belief, spacing, jacobian=False)
        if tangents and solution.evaluation.misfit <= EXPLAINED:
            near = experiment.assess(compared).worst <= LARGEST_EXCUSED
            if near or (step.added and not has_onset(step)):
                # It may be concluded from: its tangents on all frames, which cost most, are asked for once.
                # Or only unseen frames are off: in a narrow valley the last digits of the cost decide those.
                solution = _to_last_digits(problem, solution.belief, ITERATIONS // 2 if near else ITERATIONS)
                compared = experiment.compare(solution.belief, spacing, jacobian=False)
        if tangents:
            compared = with_tangents(experiment, compared, solution.belief, spacing)
    except SimulationError as error:
        say(f"grid of {1e3 * spacing:.3g} mm: {error}")
        return None
    compared, assessment, beside = beside_coarser(experiment, step, compared, spacing, say)
    moved = from_grid_to_grid(step, solution.belief, spacing)
    coarse_belief = step.belief if spacing < step.spacing else None
    changes = {
        "spacing": spacing, "jacobian_spacing": None, "refinement_spacing": None, "moved": moved,
        "coarse_belief": coarse_belief, **beside,
    }  # fmt: skip
    return step.refitted(solution, compared, assessment, **changes)


def _out_of_reach(experiment: Experiment, step: Step, solution: Solution, spacing: float) -> bool:
    """Whether no further iteration brings a step near the floor: what it leaves on all frames is neither the
    coarser grid's that it comes from nor this one's. Raises SimulationError."""
    if solution.converged or not step.added or has_onset(step) or spacing >= step.spacing:
        return False
    worst = experiment.assess(experiment.compare(solution.belief, spacing, jacobian=False)).worst
    times = FURTHER if _creeps(solution) else FURTHER * BEYOND
    return far_beyond(step.assessment.worst, worst, step.spacing / spacing, times=times)


def _creeps(solution: Solution) -> bool:
    """Whether a fit stays clear of the noise even if all further iterations bring what the better of the last
    two brought."""
    if len(solution.history) < 3:
        return False
    a, b, c = solution.history[-3:]
    least = c - (ITERATIONS - FIRST) * max(a - b, b - c)
    return least > NEAR_FLOOR**2 * c / solution.evaluation.misfit**2


def _to_last_digits(problem: Problem, belief: Belief, iterations: int = ITERATIONS // 2) -> Solution:
    """The fit at the minimum, to a small share of the standard errors; refits stop short of it."""
    return minimise(problem, belief, iterations=iterations, relative_tolerance=LAST_DIGITS)


def converged_fit(experiment: Experiment, step: Step, report: Callable[[str], None] | None = None) -> Step:
    """The step with its numbers at the minimum (see `_to_last_digits`)."""
    if step.jacobian_spacing is not None or step.assessment.worst > EXPLAINED:
        return step  # what Jacobians of another grid lead to has none, and the grid's error hides them
    say = report or (lambda _text: None)
    problem = experiment.problem(step.spacing)
    jacobian_problem = jacobian_source(experiment, step.spacing)
    solution = relocated(
        problem, step.solution, columns_of=jacobian_problem, relative_tolerance=LAST_DIGITS, report=report
    )
    solution = _to_last_digits(problem, solution.belief)
    if solution.belief is step.belief:
        return step
    # Where a refinement excused a part of the misfit, it is asked again.
    compared = compared_as_step(experiment, step, solution.belief)
    assessment = experiment.assess(compared)
    after = step.refitted(solution, compared, assessment)
    say(f"last digits: {step.assessment.worst:.3f} -> {assessment.worst:.3f} sigma in the worst range")
    return after if after.explained else step


def finely(experiment: Experiment, step: Step, report: Callable[[str], None] | None = None) -> Step:
    """An explained step on a grid as fine as the default one, where it is not at the noise and leaves less
    there: what is told of a model should be as near as a fit comes."""
    coarser = step.jacobian_spacing is None and step.spacing > 1.1 * default_spacing(experiment.capture)
    if not coarser or step.reconciled or has_onset(step) or step.assessment.worst <= AT_FLOOR:
        return step
    after = on_finer_grid(experiment, step, report)
    better = after is not None and after.explained and after.assessment.worst < step.assessment.worst
    return after if better else step


def complete(experiment: Experiment, step: Step, *, screening: bool = False) -> Step:
    """The step with the tangents of its prediction, which the floor test takes and rivals go without; without
    where the misfit is gross (see `with_tangents`).

    screening: whether a grid that is coarser than the deciding one was only for trying many models: what no
    test would excuse goes without there, for its share of the error is not asked either.
    """
    worst = step.assessment.worst
    if worst >= LARGEST_GRID_ERROR:
        return step
    if screening and worst > LARGEST_EXCUSED and not known_budget(step):
        if step.spacing > 1.1 * deciding_spacing(experiment.capture):
            return step
    if all(item.jacobian.shape[-1] == len(step.belief.free) for item in step.compared.values()):
        return step
    compared = compared_as_step(experiment, step, step.belief)
    return replace(step, compared=compared, assessment=experiment.assess(compared))


def with_budget(
    experiment: Experiment,
    step: Step,
    report: Callable[[str], None] | None = None,
    *,
    refinement_spacing: float | None = None,
) -> Step:
    """The step with the discretisation's share of its misfit known, from one refinement.

    refinement_spacing: spacing of a coarser grid [m] that shows it well enough where nothing is decided by
    it, at a hundredth of the work; a finer one is asked where it is not much coarser, or cannot carry the
    model.
    """
    refined_by = refinement_spacing
    if refined_by is not None and refined_by <= LENDS * step.spacing:
        refined_by = None
    try:
        compared = experiment.with_refinement(
            step.compared, step.belief, step.spacing, refinement_spacing=refined_by
        )
    except SimulationError:
        return step if refined_by is None else with_budget(experiment, step, report)
    assessment = experiment.assess(compared)
    known = replace(step, compared=compared, assessment=assessment, refinement_spacing=refined_by)
    report_budget(known, report)
    return known


def report_budget(step: Step, report: Callable[[str], None] | None) -> None:
    """Say a step's error budget."""
    if report:
        shares = ", ".join(f"{name} {1e3 * share:.3f}" for name, share in step.assessment.budget.items())
        report(f"shares of the misfit [mm]: {shares}")


def far_beyond(coarse: float, fine: float, ratio: float, *, times: float = BEYOND) -> bool:
    """Whether what a refit on a finer grid leaves is more than a still finer one could take away: several
    times what the error that falls with the square of the spacing would, by the two of them.

    coarse, fine: misfit in the worst range on either grid [sigma]; ratio: of their spacings; times: so many
    times that error.
    """
    rest = max(coarse - fine, 0.0) / (ratio**2 - 1.0)
    return fine - times * rest > CLEAR
