"""Fits of what sets in at some moment: a wall that is met, yielding."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

from mphygs.fit.borrowed_jacobians import LENT, approached
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.model.registry import effect

# Of what sets in, alone; then of all parameters.
ALONE, TOGETHER = 6, 3
# Share of the cost that an iteration of the former has to bring for another one: all is fitted after it.
BRINGS = 1e-2

Report = Callable[[int, Evaluation, Belief], None]


def only_onset_free(belief: Belief) -> Belief:
    """The belief with what sets in at some moment free, all else held."""
    own = [name for name in belief.effects if effect(name).kind == "threshold"]
    parameters = [replace(p, free=p.free and p.key.rsplit(".", 1)[0] in own) for p in belief.parameters]
    return replace(belief, parameters=tuple(parameters))


def with_onset_fitted(
    problem: Problem, belief: Belief, *, jacobian_problem: Problem | None = None, report: Report | None = None
) -> Belief:
    """The belief with what sets in fitted, all else as it was; as it is where nothing does.

    Fitted together from the start, materials make up for a wall that is not at its place yet, and keep it
    there: parts that hardly swing turn into rubber or jelly. Those of the frames before it are nearly right.
    jacobian_problem: the same fit on a coarser grid, whose Jacobians serve here. Raises SimulationError.
    """
    first = only_onset_free(belief)
    if not first.free:
        return belief
    if jacobian_problem is not None:
        found = approached(problem, jacobian_problem, first, iterations=ALONE, report=report)
    else:
        found = minimise(
            problem, first, iterations=ALONE, relative_tolerance=1e-3, least=BRINGS, report=report
        ).belief
    for p in first.free:
        belief = belief.with_parameter(p.key, value=found[p.key].value)
    return belief


def fit_onset_then_all(
    problem: Problem,
    belief: Belief,
    *,
    iterations: int = TOGETHER,
    jacobian_problem: Problem | None = None,
    accuracy: float = 1e-3,
    hopeless: float = math.inf,
    report: Report | None = None,
) -> Solution:
    """A fit that finds first what sets in (see `with_onset_fitted`) and then all.

    accuracy: share of the cost that a last step may promise; hopeless: chi^2 above which it ends after the
    first iteration (see `minimise`). Raises SimulationError.
    """
    belief = with_onset_fitted(problem, belief, jacobian_problem=jacobian_problem, report=report)
    first = 1 if math.isfinite(hopeless) else iterations
    if jacobian_problem is not None:
        belief = approached(problem, jacobian_problem, belief, relative_tolerance=max(accuracy, LENT))
    found = minimise(
        problem,
        belief,
        iterations=first,
        relative_tolerance=accuracy,
        hopeless=hopeless,
        report=report,
    )
    if first == iterations or found.converged or found.evaluation.chi_square > hopeless:
        return found
    return minimise(
        problem, found.belief, iterations=iterations - first, relative_tolerance=accuracy, report=report
    )
