"""Other minima of a fit: a stiff part on a soft one can move markers much as the other way round does.

They are looked for on the coarse grid, where that is cheap, and decided between on the fine one: the coarse
grid's own error can be more than what lies between two of them.

One may be so near that it is a shoulder of the same valley, and only there on one of the grids. It is seen
from the minimum itself: a few standard errors along the valley the cost rises less than the curvature says.

What swings faster than frames follow has many, a swing more or less within the frames each: so near to each
other that no search for a scale is as fine. Where a few standard errors of a stiffness lead to the crest of
the first, it is followed at steps a fraction of that over all that other searches leave between their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from mphygs.fit.levenberg_marquardt import Solution, covariance, minimise, report_of_iterations
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.errors import SimulationError

# Factor on the stiffness of one part after the other from where another minimum is looked for.
APART = 2.0
# Iterations from each of these starts, and the share of the cost that they may stop at.
ITERATIONS, ACCURACY = 6, 1e-3
# A minimum whose cost is so many times the lowest on the coarse grid is none on the fine one.
NEAR = 1.1
# Standard errors by the noise, along the valley of a stiffness, where the cost is looked at, one after the
# other as long as it has risen by less than this share of what the curvature says.
ALONG, FLAT = (4.0, 8.0, 16.0), 0.5
# Standard errors of a stiffness by itself at which a crest is looked for, where the cost has risen by less
# than `FLAT` says; steps between there and the minimum in which the cost is followed, and how many on a side.
CRESTS, STEPS, FARTHEST = (8.0, 16.0, 32.0), 4, 40
# Minima are the same where no logarithm of a stiffness differs by more.
SAME = 0.1


def other_minima(
    problem: Problem, belief: Belief, report: Callable[[str], None] | None = None
) -> list[Belief]:
    """Minima other than that of a belief, reached from where one part is softer or stiffer than there.

    problem: on the coarse grid; report: told of every iteration. One free stiffness has no other part's to be
    taken for: its scale has been looked for already.
    """
    moduli = [p.key for p in belief.free if p.key.endswith(".youngs_modulus")]
    if len(moduli) < 2:
        return []
    least = problem.evaluate(belief, jacobian=False).cost
    found: list[tuple[float, Belief]] = []
    tell = report_of_iterations(report, f"another minimum ({1e3 * problem.settings.spacing:.3g} mm)")
    for trial in _starts(belief, moduli):
        try:
            other = minimise(
                problem, trial, iterations=ITERATIONS, relative_tolerance=ACCURACY, report=tell
            )
        except SimulationError:
            continue
        if not any(_same(other.belief, known, moduli) for known in (belief, *(b for _, b in found))):
            found.append((other.evaluation.cost, other.belief))
    lowest = min([least, *(cost for cost, _ in found)])
    return [b for cost, b in sorted(found, key=lambda item: item[0]) if cost < NEAR * lowest]


def lower_along(problem: Problem, found: Solution) -> list[Belief]:
    """Beliefs of a lower cost than a solution's in the valleys of its stiffnesses, the lowest first; all
    other free numbers follow as far as the curvature says."""
    belief, evaluation = found.belief, found.evaluation
    spread = covariance(evaluation)
    lower: list[tuple[float, Belief]] = []
    for index, parameter in enumerate(belief.free):
        std = float(np.sqrt(max(spread[index, index], 0.0)))
        if not parameter.key.endswith(".youngs_modulus") or std == 0.0:
            continue
        for way in (spread[:, index] / std, -spread[:, index] / std):
            for far in ALONG:
                there = belief.at(belief.coordinates + far * way)
                try:
                    rise = problem.evaluate(there, jacobian=False).cost - evaluation.cost
                except SimulationError:
                    break
                if rise < 0.0:
                    lower.append((rise, there))
                if rise > FLAT * 0.5 * far**2:
                    break
    return [there for _, there in sorted(lower, key=lambda item: item[0])]


def beyond_crests(
    problem: Problem, found: Solution, report: Callable[[str], None] | None = None
) -> list[Belief]:
    """Where the cost has minima as one stiffness alone is followed from that of a solution, the lowest first;
    none where no crest is nearby. How much lower the other numbers would make them is not known yet.

    report: told of every stiffness that is followed, for it takes a while.
    """
    belief, evaluation = found.belief, found.evaluation
    minima: list[tuple[float, Belief]] = []
    for index, parameter in enumerate(belief.free):
        slope = float(np.linalg.norm(evaluation.jacobian[:, index]))
        if not parameter.key.endswith(".youngs_modulus") or slope == 0.0:
            continue

        def at(way: float, parameter: Parameter = parameter) -> tuple[float, Belief] | None:
            value = parameter.value * np.exp(way)
            if not parameter.lower <= value <= parameter.upper:
                return None
            there = belief.with_parameter(parameter.key, value=value)
            try:
                return problem.evaluate(there, jacobian=False).cost, there
            except SimulationError:
                return None

        crest = _crest(at, evaluation.cost, slope)
        if crest is None:
            continue
        step = crest / STEPS
        count = min(FARTHEST, int(np.log(APART) / step))
        if report:
            report(f"{parameter.key}: over the crests of its valley, {count} steps to each side")
        for way in (step, -step):
            line = [(evaluation.cost, belief)]
            for number in range(1, count + 1):
                point = at(number * way)
                if point is None:
                    break
                line.append(point)
            minima += [
                here
                for before, here, after in zip(line, line[1:], line[2:], strict=False)
                if here[0] < min(before[0], after[0])
            ]
    return [there for _, there in sorted(minima, key=lambda item: item[0])]


def _crest(
    at: Callable[[float], tuple[float, Belief] | None], cost: float, slope: float
) -> float | None:
    """How far from a minimum the cost has stopped to rise as its curvature says, as a factor's logarithm;
    None where it has not, up to where others are looked for anyway."""
    for side in (1.0, -1.0):
        for far in CRESTS:
            if far / slope > np.log(APART):
                return None
            point = at(side * far / slope)
            if point is None:
                break
            if point[0] - cost < FLAT * 0.5 * far**2:
                return far / slope
        else:
            return None
    return None


def lowest_of(
    problem: Problem,
    found: Solution,
    others: list[Belief],
    report: Callable[[str], None] | None = None,
    **options: object,
) -> Solution:
    """The lowest minimum on a problem's grid: that which was found, or where the others lead to.

    report: told of every iteration; options: of `minimise`. A solution that one of the others led to tells
    which, as its start.
    """
    best = found
    tell = report_of_iterations(report, f"another minimum ({1e3 * problem.settings.spacing:.3g} mm)")
    for belief in others:
        try:
            other = minimise(problem, belief, report=tell, **options)
        except SimulationError:
            continue
        if other.evaluation.cost < best.evaluation.cost:
            best = replace(other, start=belief)
    if best is not found and report:
        report(f"another minimum is lower: {best.evaluation.misfit:.3f} sigma")
    return best


def _starts(belief: Belief, moduli: list[str]) -> Iterator[Belief]:
    """The belief with one stiffness times a factor, where its bounds let it."""
    for key in moduli:
        for factor in (APART, 1.0 / APART):
            parameter = belief[key]
            value = parameter.value * factor
            if parameter.lower <= value <= parameter.upper:
                yield belief.with_parameter(key, value=value)


def _same(one: Belief, other: Belief, moduli: list[str]) -> bool:
    return all(abs(np.log(one[key].value / other[key].value)) < SAME for key in moduli)
