"""Fits led by Jacobians of another problem, the same on a coarser grid: the motion answers to the materials
much as it does here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mphygs.fit.damped_step import FIRST_DAMPING
from mphygs.fit.levenberg_marquardt import (
    LONGEST_STEP,
    TOLERANCE,
    Solution,
    follow_secants,
    minimise,
    worth_a_step,
)
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Steps tried with a Jacobian of another grid, before one of its own is worth its price.
BORROWED_TRIALS = 3
# The share of the cost that such a step has to promise: the last digits are not in a coarser grid.
LENT = 1e-3
# The share of the cost that an iteration by lent Jacobians has to bring for another one: they are not so much
# cheaper than its own where both grids take as many substeps.
LEADS = 1e-2


def led_by_secants(problem: Problem, belief: Belief, evaluation: Evaluation) -> Belief:
    """The belief nearer to the minimum, by steps of a Jacobian that is nearly right and the secants.

    evaluation: of the belief, with that Jacobian.
    """

    def worth(reached: Evaluation) -> float:
        return worth_a_step(reached, TOLERANCE, LENT)

    jacobian = evaluation.jacobian
    return follow_secants(problem, belief, evaluation, jacobian, FIRST_DAMPING, worth, LONGEST_STEP)[0]


class _Borrowing:
    """A problem whose Jacobians are those of another one: the same fit on a coarser grid.

    lowest: cost and belief of the best that was evaluated.
    """

    def __init__(self, problem: Problem, jacobian_problem: Problem) -> None:
        self._problem, self._jacobian_problem = problem, jacobian_problem
        self._known: list[tuple[Belief, Evaluation]] = []
        self.lowest: tuple[float, Belief] | None = None

    def stable_substep(self, belief: Belief) -> float:
        return self._problem.stable_substep(belief)

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
        # What was tried as a step is asked again for its Jacobian.
        found = next((e for b, e in self._known if b is belief), None)
        if found is None:
            found = self._problem.evaluate(belief, jacobian=False)
            self._known = [*self._known[-2:], (belief, found)]
            if self.lowest is None or found.cost < self.lowest[0]:
                self.lowest = found.cost, belief

        def lent() -> np.ndarray:
            slopes = self._jacobian_problem.evaluate(belief).jacobian
            if len(slopes) != len(found.residual):
                raise ValueError(
                    "the problem of the Jacobians has other rows; expected the same frames and markers"
                )
            return slopes

        return replace(found, slopes=lent() if jacobian else lent)

    def minimise(self, belief: Belief, **options: object) -> Solution:
        return minimise(self, belief, trials=BORROWED_TRIALS, **options)


def approached(
    problem: Problem,
    jacobian_problem: Problem,
    belief: Belief,
    *,
    iterations: int = 8,
    tolerance: float = 0.05,
    relative_tolerance: float = 1e-3,
    report: Callable[[int, Evaluation, Belief], None] | None = None,
) -> Belief:
    """The belief nearer to the minimum of a problem, by Jacobians of another one that are cheaper.

    jacobian_problem: the same fit on a coarser grid: how the motion answers to the materials is much the same
    there, and what differs the secants put right. Ends where they hardly help; a minimum is not promised.
    iterations: Jacobians of that grid. Raises SimulationError when the belief cannot be simulated.
    """
    borrowing = _Borrowing(problem, jacobian_problem)
    try:
        borrowing.minimise(
            belief,
            iterations=iterations,
            tolerance=tolerance,
            relative_tolerance=relative_tolerance,
            least=LEADS,
            report=report,
        )
    except SimulationError:
        if borrowing.lowest is None:
            raise
        # The coarser grid cannot carry what the problem's can.
    return borrowing.lowest[1]


def with_jacobian_of(jacobian_problem: Problem, problem: Problem, belief: Belief) -> Evaluation:
    """A problem's evaluation, its Jacobian that of another one. Raises SimulationError."""
    return _Borrowing(problem, jacobian_problem).evaluate(belief)


def fit_by_borrowed_jacobians(
    problem: Problem,
    jacobian_problem: Problem,
    belief: Belief,
    *,
    iterations: int = 8,
    relative_tolerance: float = 1e-3,
    report: Callable[[int, Evaluation, Belief], None] | None = None,
) -> Solution:
    """The best that Jacobians of another problem lead to, as a solution whose Jacobian is of that one as
    well.

    jacobian_problem: the same fit on a coarser grid. Raises SimulationError where either cannot be simulated.
    """
    borrowing = _Borrowing(problem, jacobian_problem)
    solution = borrowing.minimise(
        belief, iterations=iterations, relative_tolerance=relative_tolerance, report=report
    )
    cost, best = borrowing.lowest
    if cost < solution.evaluation.cost:
        solution = replace(solution, belief=best, evaluation=borrowing.evaluate(best))
    return solution
