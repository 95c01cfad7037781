"""The first iterations of a refit with an effect, from the strength that fits best."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mphygs.diagnose.ranking import RankedEffect
from mphygs.diagnose.wall import hold_friction
from mphygs.extend.known_slopes import approached_from
from mphygs.extend.onset_fit import with_onset_fitted
from mphygs.fit.borrowed_jacobians import approached
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise, promise
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

STRENGTHS = (0.5, 1.0, 2.0)
# A refit that is begun goes on for so many more iterations as long as each leaves less than this share, or
# the next promises to: a viscosity, say, goes to its strength in stages, for no step may shorten the substep
# much, and a relaxation may stand for an iteration before it finds its time.
FALLING, MORE = 0.7, 4
# Of the substep without the effect: no refit starts with less.
SHORTEST_SUBSTEP = 0.3


def _scaled(entry: RankedEffect, start: Belief, belief: Belief, strength: float) -> Belief:
    """A start of the entry with the effect's strengths times a factor."""
    out, spec = start, effect(entry.effect)
    # Of what replaces something else the null is no zero, and there is nothing to scale.
    scaled = [] if spec.replaces or spec.threshold else [*spec.of_role("strength"), *spec.of_role("flow")]
    for p in scaled:
        parameter = start[f"{spec.name}.{p.name}"]
        if parameter.free and not parameter.log:
            value = float(np.clip(parameter.value * strength, parameter.lower, parameter.upper))
            out = out.with_parameter(parameter.key, value=value)
    fitted = {p.key: p.value for p in belief.parameters}
    parameters = []
    for p in out.parameters:
        if p.key in fitted:
            # What was fitted stays where the fit left it; a wall may be where only a softer object meets it.
            p = p if entry.kind == "threshold" else replace(p, value=fitted[p.key])
        else:
            p = in_logarithm(p)
        parameters.append(p)
    return replace(out, parameters=tuple(parameters))


def in_logarithm(p: Parameter) -> Parameter:
    """A free strength that cannot be negative, to be fitted in its logarithm: far from the data a linear step
    overshoots by orders of magnitude. Any other parameter as it is."""
    if not p.free or p.log or p.lower != 0.0 or math.isfinite(p.prior_std):
        return p
    return replace(p, log=True, lower=1e-6 * p.scale, value=max(p.value, 1e-2 * p.scale))


def start_refit(
    experiment: Experiment,
    before: Solution,
    entry: RankedEffect,
    spacing: float,
    *,
    share: float = 1.0,
    iterations: int = 3,
    hopeless: float = math.inf,
    accuracy: float = 1e-3,
    jacobian_problem: Problem | None = None,
    report: Callable[[str], None] | None = None,
) -> Solution | None:
    """The first few iterations of a refit with the entry's effect, from half, one and two times its estimate,
    whichever fits best; where it has several starts, from the one that is best after an iteration. A few more
    as long as they bring much.

    share: of the fitted frames, from the first on, to refit on; hopeless: chi^2 above which it ends once an
    iteration brings little, or as many are made as any refit may have; accuracy: share of the cost that a
    last step may promise; jacobian_problem: the same fit on a coarser grid, whose Jacobians lead as far as
    they serve. Returns None where no such model can be simulated.
    """
    problem = experiment.window(spacing, share)
    starts = [_strongest(problem, before.belief, entry, start) for start in (entry.start, *entry.others)]
    begun: list[Solution] = []
    for start in starts:
        if start is None:
            continue
        try:
            begun.append(_led(problem, before, entry, start, jacobian_problem, accuracy))
        except SimulationError:
            continue
    if not begun:
        return None
    solution = min(begun, key=lambda item: item.evaluation.chi_square)
    done, most = len(solution.history) - 1, iterations + MORE
    solution, done = _falling(problem, solution, done, most, accuracy, hopeless)
    if solution.evaluation.chi_square < hopeless:
        if done < iterations and not solution.converged:
            try:
                solution = minimise(
                    problem, solution.belief, iterations=iterations - done, relative_tolerance=accuracy
                )
            except SimulationError:
                return None
            done += len(solution.history) - 1
        solution, done = _falling(problem, solution, done, most, accuracy)
    if report:
        report(f"with {entry.label}: {solution.evaluation.misfit:.3f} sigma after {done} iterations")
    return solution


def _falling(
    problem: Problem, solution: Solution, done: int, most: int, accuracy: float, until: float = 0.0
) -> tuple[Solution, int]:
    """A solution gone on with as long as an iteration brings much, to `most` of them or below a chi^2.

    done: the number of those made, returned with it; until: that chi^2."""
    while done < most and solution.evaluation.chi_square >= until:
        further = _further(problem, solution, accuracy)
        if further is None:
            break
        solution, done = further, done + 1
    return solution, done


def _further(problem: Problem, solution: Solution, accuracy: float) -> Solution | None:
    """One more iteration where the last one brought much or the next promises to, and one can be made."""
    costs = solution.history[-2:]
    if solution.converged or len(costs) < 2:
        return None
    evaluation, little = solution.evaluation, costs[1] > FALLING * costs[0]
    # Where noise alone would leave more than that share of it, no Jacobian is needed to tell.
    if little and FALLING * evaluation.chi_square < evaluation.data_rows:
        return None
    try:
        if little and costs[1] - promise(solution.belief, evaluation) > FALLING * costs[1]:
            return None
        further = minimise(problem, solution.belief, iterations=1, relative_tolerance=accuracy)
    except SimulationError:
        return None
    return further if len(further.history) > 1 else None


def _strongest(problem: Problem, before: Belief, entry: RankedEffect, begin: Belief) -> Belief | None:
    """A start of an entry at the strength that fits best; None where none can be simulated."""
    strengths = STRENGTHS if entry.kind != "threshold" else (1.0,)
    best, best_cost = None, np.inf
    predictor = next(iter(problem.predictors.values()))
    longest = predictor.stable_substep(before)
    for strength in strengths:
        start = _scaled(entry, begin, before, strength)
        # Far from the data the linear estimate can be many times too strong, and a strong viscosity needs
        # short substeps: start weaker, the iterations find the way.
        while (
            entry.kind != "threshold"
            and predictor.stable_substep(start) < SHORTEST_SUBSTEP * longest
            and strength > 1e-3
        ):
            strength *= 0.5
            start = _scaled(entry, begin, before, strength)
        try:
            cost = problem.evaluate(start, jacobian=False).cost
        except SimulationError:
            continue
        if cost < best_cost:
            best, best_cost = start, cost
    return best


def _led(
    problem: Problem,
    before: Solution,
    entry: RankedEffect,
    start: Belief,
    jacobian_problem: Problem | None,
    accuracy: float,
) -> Solution:
    """The first iteration from a start. Raises SimulationError where it cannot be simulated."""
    if entry.kind == "threshold":
        start = with_onset_fitted(problem, hold_friction(start), jacobian_problem=jacobian_problem)
    elif jacobian_problem is not None:
        start = approached(problem, jacobian_problem, start)
    else:
        start = approached_from(problem, before, start)
    return minimise(problem, start, iterations=1, relative_tolerance=accuracy)
