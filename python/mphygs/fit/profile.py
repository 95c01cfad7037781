"""Intervals from the likelihood: how far a number can be moved, the others fitted anew.

A standard error is the curvature at the minimum. Where it changes with the number itself (an effect that is
hardly there has a larger relative error than a strong one) the interval of two of them reaches too far on one
side and not far enough on the other; the profile of the cost needs no such symmetry, and is the same in any
coordinate.

Source: Venzon & Moolgavkar, "A method for computing profile-likelihood-based confidence intervals", Applied
Statistics 37, 1988.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from mphygs.fit.determined import components
from mphygs.fit.levenberg_marquardt import Solution, covariance, minimise
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Of a number of standard deviations: how near to it an end of an interval is looked for.
PRECISION = 0.02
# Refits that one end may take, and steps of the fit in each.
REFITS, ITERATIONS = 8, 8
# The fall of the cost that is worth another step: a hundredth of a standard deviation at an end.
TOLERANCE = 0.02
# The minimum itself, which all ends are counted from.
MINIMUM_TOLERANCE = 1e-3


@dataclass(frozen=True)
class Interval:
    """lower, upper: in the parameter's unit; at a bound of the parameter where the misfit does not object
    before."""

    lower: float
    upper: float


@dataclass(frozen=True, eq=False)
class Profile:
    """The cost around a minimum, one free parameter held and the others fitted. solution: the minimum."""

    problem: Problem
    solution: Solution

    @classmethod
    def of(cls, problem: Problem, belief: Belief, *, iterations: int = 20) -> Profile:
        """From a belief at or near its minimum, which is gone to first. Raises SimulationError."""
        options = {"tolerance": MINIMUM_TOLERANCE, "relative_tolerance": 0.0}
        return cls(problem, minimise(problem, belief, iterations=iterations, **options))

    def root(self, key: str, value: float) -> float:
        """Signed root of twice the rise of the cost where a parameter has `value`, in its unit: the number of
        standard deviations that it is off, minus below the minimum.

        Raises KeyError where no free parameter has that key, SimulationError where the value cannot be
        simulated.
        """
        belief = self.solution.belief
        index = self._index(key)
        there = replace(belief[key], value=value)
        away = there.coordinate - belief[key].coordinate
        if away == 0.0:
            return 0.0
        spread = covariance(self.solution.evaluation)[:, index]
        # The others begin where the curvature at the minimum expects them.
        near = belief.at(belief.coordinates + spread / max(spread[index], 1e-300) * away)
        held = near.with_parameter(key, value=value, free=False)
        if held.free:
            refit = minimise(
                self.problem, held, iterations=ITERATIONS, tolerance=TOLERANCE, relative_tolerance=0.0
            )
            cost = refit.evaluation.cost
        else:
            cost = self.problem.evaluate(held, jacobian=False).cost
        # Its own prior is not among those of the free ones any more.
        cost += 0.5 * there.prior_residual[0] ** 2
        rise = cost - self.solution.evaluation.cost
        return math.copysign(math.sqrt(2.0 * max(rise, 0.0)), away)

    def interval(self, key: str, deviations: float = 2.0) -> Interval:
        """Where the root passes -deviations and deviations."""
        return Interval(self._end(key, -deviations), self._end(key, deviations))

    def _index(self, key: str) -> int:
        keys = [p.key for p in self.solution.belief.free]
        if key not in keys:
            raise KeyError(key)
        return keys.index(key)

    def _end(self, key: str, deviations: float) -> float:
        parameter, index = self.solution.belief[key], self._index(key)
        error = math.sqrt(max(covariance(self.solution.evaluation)[index, index], 1e-300))
        middle = parameter.coordinate
        bound = parameter.lower if deviations < 0.0 else parameter.upper
        inside, outside = 0.0, None  # distances that are too near, and too far
        distance = abs(deviations) * error
        for _ in range(REFITS):
            value = parameter.at(middle + math.copysign(distance, deviations)).value
            try:
                reached = abs(self.root(key, value))
            except SimulationError:
                reached = math.inf
            if abs(reached - abs(deviations)) < PRECISION * abs(deviations):
                return value
            if reached < abs(deviations):
                if value == bound:
                    return bound
                inside = distance
            else:
                outside = distance
            # The root is nearly straight: on to where a line from the minimum has it, or halfway.
            ahead = distance * abs(deviations) / max(reached, 1e-3)
            ahead = min(ahead, 3.0 * distance)
            if outside is not None and not inside < ahead < outside:
                ahead = 0.5 * (inside + outside)
            distance = ahead
        return parameter.at(middle + math.copysign(distance, deviations)).value


def intervals(
    problem: Problem,
    belief: Belief,
    *,
    deviations: float = 2.0,
    report: Callable[[str], None] | None = None,
) -> dict[str, Interval]:
    """By key, the interval of every free parameter of a fitted belief, but for components of a direction:
    they are fitted as a vector of any length, of which nothing is known.

    report: told each parameter before it is looked for. Raises SimulationError where the belief cannot be
    simulated.
    """
    profile = Profile.of(problem, belief)
    found = {}
    vectors = components(belief.free)
    wanted = [p for p in profile.solution.belief.free if p.key not in vectors]
    for number, parameter in enumerate(wanted, start=1):
        if report:
            report(f"interval of {parameter.key} ({number} of {len(wanted)})")
        found[parameter.key] = profile.interval(parameter.key, deviations)
    return found
