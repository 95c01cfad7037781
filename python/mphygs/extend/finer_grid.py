"""A grid finer than the deciding one, for a model that explains nearly all: the rest may be the grid's."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mphygs.compare.assess import LARGEST_EXCUSED, LARGEST_GRID_ERROR, PRACTICAL_FLOOR, Compared
from mphygs.extend.step import Step, beside_coarser, from_grid_to_grid, known_budget, staying
from mphygs.fit.borrowed_jacobians import approached, fit_by_borrowed_jacobians, with_jacobian_of
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise, report_of_iterations
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.spacings import screening_spacing
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# A grid so many times as fine costs three times as much; its tangents are never asked for.
FINER = 1.3
# Rivals are fitted less closely: whoever could lead is fitted there as well.
ITERATIONS, ACCURACY, RIVALS_ACCURACY = 4, 3e-4, 1e-3
# A grid so many times as coarse is many times as cheap.
LENDS = 1.3


def jacobian_source(experiment: Experiment, spacing: float, share: float = 1.0) -> Problem | None:
    """The fit to the first share of the frames on the screening grid, to lend its Jacobians to that on a
    finer one; None for a grid that is as coarse."""
    coarse = screening_spacing(experiment.capture)
    if spacing > coarse / LENDS:
        return None
    for name in experiment.fitted:
        experiment.predictor(name, coarse)
    return experiment.window(coarse, share)


def on_finer_grid(
    experiment: Experiment, step: Step, report: Callable[[str], None] | None = None
) -> Step | None:
    """The step fitted on a finer grid by the Jacobians of its own; None where that cannot be simulated.

    The change from grid to grid is the discretisation's share of what it leaves.
    """
    return fitted_by_coarse_jacobians(experiment, step, round(step.spacing / FINER, 6), step.spacing, report)


def fitted_by_coarse_jacobians(
    experiment: Experiment,
    step: Step,
    spacing: float,
    jacobian_spacing: float,
    report: Callable[[str], None] | None = None,
) -> Step | None:
    """The step fitted on one grid by the Jacobians of a coarser one, of spacing `jacobian_spacing` [m]."""
    say = report or (lambda _text: None)
    derivatives = f"with the derivatives of {1e3 * jacobian_spacing:.3g} mm"
    say(f"refitting on a grid of {1e3 * spacing:.3g} mm, {derivatives}")
    try:
        for name in experiment.fitted:
            experiment.predictor(name, jacobian_spacing)
        solution = fit_by_borrowed_jacobians(
            experiment.problem(spacing),
            experiment.problem(jacobian_spacing),
            step.belief,
            iterations=ITERATIONS,
            relative_tolerance=ACCURACY,
            report=report_of_iterations(report, f"{1e3 * spacing:.3g} mm"),
        )
        compared = compared_on_both_grids(experiment, solution.belief, spacing, jacobian_spacing)
    except SimulationError as error:
        say(f"grid of {1e3 * spacing:.3g} mm: {error}")
        return None
    compared, assessment, beside = beside_coarser(experiment, step, compared, spacing, say)
    moved = from_grid_to_grid(step, solution.belief, spacing)
    changes = {
        "spacing": spacing,
        "jacobian_spacing": jacobian_spacing,
        "refinement_spacing": None,
        "moved": moved,
        **beside,
    }
    return step.refitted(solution, compared, assessment, **changes)


def evaluated(
    experiment: Experiment, belief: Belief, spacing: float, jacobian_spacing: float | None
) -> Evaluation:
    """The fitted frames at a belief, with the Jacobian that a step there has. jacobian_spacing: see `Step`.

    Raises SimulationError.
    """
    if jacobian_spacing is None:
        return experiment.problem(spacing).evaluate(belief)
    for name in experiment.fitted:
        experiment.predictor(name, jacobian_spacing)
    return with_jacobian_of(experiment.problem(jacobian_spacing), experiment.problem(spacing), belief)


def _change(best: Step) -> dict[str, np.ndarray]:
    """How a step's prediction changes from the grid of its Jacobians to its own, (T, M, 3) [m] of every
    sequence."""
    whole = (best.jacobian_spacing / best.spacing) ** 2 - 1.0
    return {name: whole * item.refinement for name, item in best.compared.items()}


def corrected_coarse_problem(experiment: Experiment, best: Step) -> Problem:
    """The fit on the grid that lent a step its Jacobians, to what was measured less how that step's
    prediction changes from there to its own grid."""
    problem, change = experiment.problem(best.jacobian_spacing), _change(best)
    moved = {
        name: replace(experiment.observations[name], position=experiment.observations[name].position - by)
        for name, by in change.items()
    }
    return Problem(problem.capture, problem.settings, problem.ranges, moved, problem.predictors)


def rival_on_coarse_grid(
    experiment: Experiment,
    problem: Problem,
    rival: Step,
    best: Step,
    report: Callable[[str], None] | None = None,
) -> Step | None:
    """A rival on the finer grid of the best step, as far as that step's change from grid to grid tells.

    problem: see `corrected_coarse_problem`. What two models that explain the same motion owe to a grid is
    much the same, so that no run on the finer one is needed. Jacobians of the screening grid lead as far as
    they serve, where that is coarser yet; the comparison is without tangents. None where the rival cannot be
    simulated.
    """
    jacobian_spacing, change = best.jacobian_spacing, _change(best)
    say = report or (lambda _text: None)
    say(f"{', '.join(rival.added)} on {1e3 * jacobian_spacing:.3g} mm, less what the grid changes")
    try:
        coarser = jacobian_source(experiment, jacobian_spacing)
        belief = rival.belief if coarser is None else approached(problem, coarser, rival.belief)
        solution = minimise(
            problem,
            belief,
            iterations=ITERATIONS,
            relative_tolerance=RIVALS_ACCURACY,
            report=report_of_iterations(report, f"{1e3 * jacobian_spacing:.3g} mm"),
        )
        compared = experiment.compare(solution.belief, jacobian_spacing, jacobian=False)
    except SimulationError as error:
        say(f"grid of {1e3 * jacobian_spacing:.3g} mm: {error}")
        return None
    compared = {
        name: replace(
            item, predicted=item.predicted + change[name], refinement=best.compared[name].refinement
        )
        for name, item in compared.items()
    }
    assessment = experiment.assess(compared)
    say(f"{rival.assessment.worst:.3f} -> {assessment.worst:.3f} sigma in the worst range")
    return rival.refitted(
        solution,
        compared,
        assessment,
        spacing=best.spacing,
        jacobian_spacing=jacobian_spacing,
        refinement_spacing=None,
    )


def compared_on_both_grids(
    experiment: Experiment, belief: Belief, spacing: float, jacobian_spacing: float
) -> dict[str, Compared]:
    """A belief compared on one grid, with the tangents of a coarser one of spacing `jacobian_spacing` [m] and
    the discretisation's share that the change between the two shows."""
    here = experiment.compare(belief, spacing, jacobian=False)
    there = experiment.compare(belief, jacobian_spacing, jacobian=False)
    # Richardson: the error of the finer grid is the change over r^2 - 1, r the ratio of the spacings.
    whole = (jacobian_spacing / spacing) ** 2 - 1.0
    compared = {
        name: replace(item, refinement=(item.predicted - there[name].predicted) / whole)
        for name, item in here.items()
    }
    return with_tangents(experiment, compared, belief, jacobian_spacing)


def compared_on_grid(
    experiment: Experiment,
    belief: Belief,
    spacing: float,
    *,
    refined: bool = False,
    refinement_spacing: float | None = None,
) -> dict[str, Compared]:
    """A belief compared on a grid, with tangents (see `with_tangents`).

    refined: whether the discretisation's share is asked for, refinement_spacing: on which grid, as `Step`
    says. Raises SimulationError.
    """
    compared = experiment.compare(
        belief, spacing, jacobian=False, refine=refined, refinement_spacing=refinement_spacing
    )
    return with_tangents(experiment, compared, belief, spacing)


def compared_as_step(experiment: Experiment, step: Step, belief: Belief) -> dict[str, Compared]:
    """A belief compared as a step's was, the discretisation's share included where the step knows it.

    Raises SimulationError.
    """
    if step.jacobian_spacing is not None:
        compared = compared_on_both_grids(experiment, belief, step.spacing, step.jacobian_spacing)
    else:
        compared = compared_on_grid(
            experiment,
            belief,
            step.spacing,
            refined=known_budget(step),
            refinement_spacing=step.refinement_spacing,
        )
    return staying(compared) if step.stays else compared


def with_tangents(
    experiment: Experiment, compared: dict[str, Compared], belief: Belief, spacing: float
) -> dict[str, Compared]:
    """A comparison with the tangents of its prediction on all frames, the dearest of all runs.

    Those of the screening grid instead of `spacing` [m] where the misfit itself says that the model explains
    the motion, or that no test of the floor will excuse it: they decide nothing then. None at all where no
    grid's error will excuse it either.
    """
    worst = experiment.assess(compared).worst
    if worst >= LARGEST_GRID_ERROR:
        return compared

    def lent_by(grid: float) -> dict[str, Compared]:
        there = experiment.compare(belief, grid)
        return {
            name: replace(
                item,
                jacobian=there[name].jacobian,
                tangents_of=grid,
                sensors=tuple(
                    replace(own, jacobian=other.jacobian)
                    for own, other in zip(item.sensors, there[name].sensors, strict=True)
                ),
            )
            for name, item in compared.items()
        }

    coarse = screening_spacing(experiment.capture)
    doubtful = PRACTICAL_FLOOR < worst <= LARGEST_EXCUSED
    if spacing > coarse / LENDS or doubtful:
        return lent_by(spacing)
    try:
        return lent_by(coarse)
    except SimulationError:  # the coarse grid cannot carry it
        return lent_by(spacing)


def best_fitting(problem: Problem, beliefs: Sequence[Belief]) -> Belief | None:
    """The belief that fits best, the first of equals; None where none can be simulated."""
    costs = []
    for number, belief in enumerate(beliefs):
        try:
            costs.append((problem.evaluate(belief, jacobian=False).cost, number))
        except SimulationError:
            continue
    return beliefs[min(costs)[1]] if costs else None
