"""Levenberg-Marquardt on tangents, with bounds: the fast way when unknowns number in the tens.

Source: Nocedal & Wright, Numerical Optimization, section 10.3; scaling by the diagonal of J^T J
after More, "The Levenberg-Marquardt algorithm: implementation and theory", 1978; secant steps between
two Jacobians after Broyden, "A class of methods for solving nonlinear simultaneous equations", 1965.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mphygs.fit.damped_step import (
    FIRST_DAMPING,
    LEAST_DAMPING,
    bounded_step,
    promised_by,
    secant,
    worthwhile_damping,
)
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Of the present substep: no single step of the optimiser may shorten it more.
SHORTEST_SUBSTEP = 0.4
# Steps between two Jacobians, each of which costs as much as nine motions or more; a step has to bring these
# shares of what was promised: for another after it, and to be taken at all.
SECANTS, TRUSTED, TAKEN = 3, 0.3, 0.05
# The fall of the cost that no step is worth taking for; the longest step of any logarithm.
TOLERANCE, LONGEST_STEP = 0.05, 1.5
# A gross misfit of which an iteration leaves this share is not worth another one.
HARDLY = 0.9
TOO_LITTLE = "an iteration brought too little"


@dataclass(frozen=True, eq=False)
class Solution:
    """belief: at the minimum; evaluation: there; history: cost after every iteration; start: minimum of a
    coarser grid that led here, where it is another than the one that the fit came with."""

    belief: Belief
    evaluation: Evaluation
    history: tuple[float, ...]
    converged: bool
    reason: str
    start: Belief | None = None


def worth_a_step(evaluation: Evaluation, tolerance: float, relative: float) -> float:
    """The fall of the cost that another step is worth taking for.

    A model that is far from the data anyway is not worth the last digits of its numbers.
    """
    factor = 100.0 if evaluation.misfit > 5.0 else 10.0 if evaluation.misfit > 2.0 else 1.0
    return tolerance + factor * relative * evaluation.cost


def follow_secants(
    problem: Problem,
    belief: Belief,
    reached: Evaluation,
    jacobian: np.ndarray,
    damping: float,
    worth: Callable[[Evaluation], float],
    longest_step: float,
) -> tuple[Belief, Evaluation]:
    """The belief after a few more steps that need no new Jacobian, as long as they hold what they promise;
    its evaluation, without Jacobian."""
    logs = np.array([p.log for p in belief.free])
    substep = problem.stable_substep(belief)
    for _ in range(SECANTS):
        normal = jacobian.T @ jacobian
        gradient = jacobian.T @ reached.residual
        diagonal = np.maximum(np.diag(normal), 1e-12)
        step = bounded_step(belief, normal + damping * np.diag(diagonal), gradient)
        promised = promised_by(normal, gradient, step)
        if promised < worth(reached) or (logs.any() and np.abs(step[logs]).max() > longest_step):
            break
        ahead = belief.at(belief.coordinates + step)
        if problem.stable_substep(ahead) < SHORTEST_SUBSTEP * substep:
            break
        try:
            trial = problem.evaluate(ahead, jacobian=False)
        except SimulationError:
            break
        ratio = (reached.cost - trial.cost) / promised
        if ratio < TAKEN:
            break
        jacobian = secant(jacobian, reached.residual, trial.residual, step, diagonal)
        belief, reached = ahead, trial
        if ratio < TRUSTED:
            break
    return belief, reached


def report_of_iterations(
    report: Callable[[str], None] | None, what: str
) -> Callable[[int, Evaluation, Belief], None] | None:
    """A report of iterations as lines of text; None where nobody listens."""
    if report is None:
        return None
    return lambda iteration, evaluation, _belief: report(
        f"{what}: iteration {iteration}, {evaluation.misfit:.3f} sigma"
    )


def minimise(
    problem: Problem,
    belief: Belief,
    *,
    iterations: int = 20,
    tolerance: float = TOLERANCE,
    relative_tolerance: float = 1e-4,
    longest_step: float = LONGEST_STEP,
    trials: int = 10,
    gross: float = np.inf,
    dwell: tuple[int, float] | None = None,
    hopeless: float = np.inf,
    least: float = 0.0,
    known: Evaluation | None = None,
    report: Callable[[int, Evaluation, Belief], None] | None = None,
) -> Solution:
    """Minimise half the sum of squares of a problem over the free parameters of a belief.

    iterations: Jacobians, each used for a few steps; tolerance, relative_tolerance: stop when the next step
    promises less than tolerance (in units of a squared standard deviation) plus this share of the cost;
    longest_step: of any logarithm in one step; trials: steps tried with one Jacobian, shorter and shorter;
    gross: misfit [sigma] above which it ends where an iteration leaves nearly all of it;
    dwell: iterations, and the misfit [sigma] above which it ends after these; hopeless: chi^2 above which it
    ends after the first iteration; least: share of the cost that an iteration has to bring, else it is the
    last one; known: the evaluation of the starting belief, where it is at hand. Raises SimulationError when
    even the starting belief cannot be simulated.
    """
    current = problem.evaluate(belief) if known is None else known
    history = [current.cost]
    damping, reason, converged = FIRST_DAMPING, "iterations used up", False

    def worth(evaluation: Evaluation) -> float:
        return worth_a_step(evaluation, tolerance, relative_tolerance)

    if report:
        report(0, current, belief)
    for iteration in range(1, iterations + 1):
        normal = current.jacobian.T @ current.jacobian
        gradient = current.jacobian.T @ current.residual
        diagonal = np.maximum(np.diag(normal), 1e-12)
        accepted = False
        substep = problem.stable_substep(belief)
        damping = worthwhile_damping(belief, normal, gradient, damping, worth(current))
        for _ in range(trials):
            step = bounded_step(belief, normal + damping * np.diag(diagonal), gradient)
            largest = np.abs(step).max(initial=0.0)
            logs = np.array([p.log for p in belief.free])
            if logs.any() and np.abs(step[logs]).max() > longest_step:
                step *= longest_step / np.abs(step[logs]).max()
            promised = promised_by(normal, gradient, step)
            if largest == 0.0 or promised < worth(current):
                converged, reason = True, "converged"
                break
            trial_belief = belief.at(belief.coordinates + step)
            # A step far beyond the linear model may ask for a hopelessly short substep: go there in stages.
            for _halving in range(12):
                if problem.stable_substep(trial_belief) >= SHORTEST_SUBSTEP * substep:
                    break
                step = 0.5 * step
                trial_belief = belief.at(belief.coordinates + step)
            promised = promised_by(normal, gradient, step)
            try:
                trial = problem.evaluate(trial_belief, jacobian=False)
            except SimulationError:
                damping = max(damping, 1e-3) * 10.0
                continue
            ratio = (current.cost - trial.cost) / promised
            if ratio > 1e-3:
                accepted = True
                damping = max(damping / (10.0 if ratio > 0.7 else 2.0), LEAST_DAMPING)
                break
            damping = max(damping, 1e-4) * 8.0
        if converged:
            break
        if not accepted:
            reason = "no step lowers the cost"
            converged = True
            break
        belief, reached = trial_belief, trial
        if ratio > TRUSTED:
            after = secant(current.jacobian, current.residual, trial.residual, step, diagonal)
            belief, reached = follow_secants(problem, belief, trial, after, damping, worth, longest_step)
        if iteration == 1 and reached.chi_square > hopeless:
            history.append(reached.cost)
            return Solution(belief, reached, tuple(history), False, "hopeless after an iteration")
        little = current.cost - reached.cost < least * current.cost
        # Its Jacobian is computed once something asks for it: another iteration, or who goes on from here.
        before, current = current, reached
        history.append(current.cost)
        if report:
            report(iteration, current, belief)
        if current.misfit > max(gross, HARDLY * before.misfit):
            reason = "gross, and hardly less by another iteration"
            break
        if dwell is not None and iteration >= dwell[0] and current.misfit > dwell[1]:
            reason = "gross after all iterations that it is worth"
            break
        if little:
            reason = TOO_LITTLE
            break
    return Solution(belief, current, tuple(history), converged, reason)


def promise(belief: Belief, evaluation: Evaluation) -> float:
    """The fall of the cost that another step promises. evaluation: of the belief, with its Jacobian."""
    normal = evaluation.jacobian.T @ evaluation.jacobian
    gradient = evaluation.jacobian.T @ evaluation.residual
    step = bounded_step(belief, normal + FIRST_DAMPING * np.diag(np.diag(normal)), gradient)
    return promised_by(normal, gradient, step)


def still_at_minimum(
    belief: Belief,
    before: Evaluation,
    now: Evaluation,
    *,
    tolerance: float = 0.05,
    relative_tolerance: float = 1e-4,
) -> bool:
    """Whether a belief that a fit led to would stay where it is beside other measurements (see `minimise`).

    before, now: its evaluations, with Jacobian. Where that is of another grid it promises what cannot be had,
    before and now.
    """
    more = promise(belief, now) - promise(belief, before)
    return more < worth_a_step(now, tolerance, relative_tolerance)


def covariance(evaluation: Evaluation) -> np.ndarray:
    """Covariance of the free coordinates at a minimum, (P, P), priors included."""
    normal = evaluation.jacobian.T @ evaluation.jacobian
    return np.linalg.pinv(normal, rcond=1e-14, hermitian=True)
