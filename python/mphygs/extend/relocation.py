"""Places that an effect may sit at besides the one that a fit is stuck at."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence

import numpy as np

from mphygs.diagnose.effect_variants import PLACES, spread_places
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.place_fit import LONGEST_COORDINATE, movable, moved, place_of, relocated, walked
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.scene.closest import closest_material
from mphygs.simulate.errors import SimulationError

# Cells from where it is, in the directions of a cube's faces, edges and corners; cells between two of them.
REACH, APART = 4.0, 1.0
# Times its strength that an effect may have at another place: near an axis a mass leans it little.
WEAKEST, STRONGEST = 0.05, 4.0
# Of its scale, a strength that is none.
FITTED_AWAY = 0.01
# Of the other places, so many are fitted from; those that leave so many times the cost are not walked from.
KEPT, BEHIND = 2, 2.0
# What leaves less [sigma] is at noise: it is at its place.
AT_NOISE = 1.03


def places_around(problem: Problem, here: np.ndarray, reach: float = REACH) -> np.ndarray:
    """(K, 3) places of the material to all sides of one (3,), so many cells away where there is room [m]."""
    cell = problem.settings.spacing
    sides = np.array([side for side in itertools.product((-1.0, 0.0, 1.0), repeat=3) if any(side)])
    sides /= np.linalg.norm(sides, axis=1, keepdims=True)
    found: list[np.ndarray] = []
    for place in closest_material(problem.capture.parts, here + reach * cell * sides).anchor:
        if all(np.linalg.norm(place - other) > APART * cell for other in (here, *found)):
            found.append(place)
    return np.array(found).reshape(-1, 3)


def other_places(
    problem: Problem, solution: Solution, name: str, places: Sequence[np.ndarray], kept: int = KEPT
) -> list[Belief]:
    """Beliefs of a fit with one of its effects at the most promising of other places (K, 3) [m], the best
    first: those of the least cost, to first order, once all else has given way by a step, and the effect has
    the strength that serves best there. A step of the place by its derivative does not get round a corner of
    the material.

    Raises SimulationError where the fit cannot be simulated without the effect.
    """
    jacobian, key = solution.evaluation.jacobian, f"{name}.{effect(name).fitted[0].name}"
    absorbed = np.linalg.qr(jacobian)[0]

    def left(residual: np.ndarray) -> np.ndarray:
        return residual - absorbed @ (absorbed.T @ residual)

    def after_a_step(residual: np.ndarray) -> np.ndarray:
        step = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
        return residual + jacobian @ (step / max(1.0, np.abs(step).max(initial=0.0) / LONGEST_COORDINATE))

    def residual_of(belief: Belief) -> np.ndarray:
        return problem.evaluate(belief, jacobian=False).residual

    own = solution.belief[key]
    # At a wrong place it may have been fitted away.
    strength = own.value if abs(own.value) > FITTED_AWAY * own.scale else own.scale
    smallest = solution.belief.with_parameter(key, value=1e-3 * strength)
    without = left(residual_of(smallest))
    ranked: list[tuple[float, int, Belief]] = []
    for number, place in enumerate(places):
        there = moved(solution.belief, name, place).with_parameter(key, value=strength)
        try:
            change = left(residual_of(there)) - without
            times = float(np.clip(-(change @ without) / max(change @ change, 1e-300), WEAKEST, STRONGEST))
            there = there.with_parameter(key, value=times * strength)
            rest = after_a_step(residual_of(there))
        except SimulationError:
            continue
        ranked.append((float(rest @ rest), number, there))
    return [belief for _, _, belief in sorted(ranked, key=lambda item: item[:2])[:kept]]


def relocated_anywhere(
    problem: Problem,
    solution: Solution,
    *,
    iterations: int = 4,
    relative_tolerance: float = 1e-3,
    report: Callable[[str], None] | None = None,
) -> Solution:
    """A fit with the places of its effects fitted (see `relocated`), where that leaves more than noise from
    other places around and all over the object as well. Raises SimulationError."""
    solution = relocated(
        problem, solution, iterations=iterations, relative_tolerance=relative_tolerance, report=report
    )
    body = next(iter(problem.predictors.values())).body
    for name in movable(solution.belief):
        if solution.evaluation.misfit < AT_NOISE:
            break
        around = places_around(problem, place_of(solution.belief, name))
        for start in other_places(problem, solution, name, [*around, *spread_places(body, PLACES)]):
            try:
                other = minimise(
                    problem, start, iterations=iterations, relative_tolerance=relative_tolerance
                )
                if other.evaluation.cost < BEHIND * solution.evaluation.cost:
                    other = walked(problem, other, name, None, iterations, relative_tolerance, report)
            except SimulationError:
                continue
            if other.evaluation.cost < solution.evaluation.cost:
                solution = other
    return solution
