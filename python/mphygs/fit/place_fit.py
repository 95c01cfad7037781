"""Where an effect at a place sits: the derivative of a fit by the place, and the place fitted.

A place is no number of a belief: it is a setting of its term, chosen from a few candidates. Between them the
prediction changes smoothly; its derivative is taken from places half a cell to each side, in the material.
How surely it is known is a setting as well ("place_std", (3,) [m], and "place_determined"), of beliefs that
are concluded from.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.scene.closest import closest_material
from mphygs.simulate.errors import SimulationError

# Of a cell: how far to each side a derivative by the place is taken; less than the second number of it, where
# the material ends, is no direction that a place can be moved in.
SIDE, THIN = 0.5, 0.25
# Cells that a place is moved at once, at most; how often; shorter steps tried; what a step has to promise
# [half a squared standard deviation], besides its share of the cost.
LONGEST, ROUNDS, HALVINGS, WORTH = 4.0, 12, 3, 0.1
# Cells around a place whose middle is tried as well.
AROUND = 3.0
# Settings of a place that was fitted.
CONCLUDED = ("place_std", "place_determined")
# Of any logarithm, a material's say, that gives way to the move.
LONGEST_COORDINATE = 1.0


@dataclass(frozen=True, eq=False)
class PlaceColumns:
    """The derivative of a residual by where an effect sits. columns: (N, K), data rows only are not zero;
    moves: (K, 3), how far the place is moved by one of each [m]; prior: (K,) standard deviations of how many
    of each before any measurement, the object's size; room: (3,) [m] of material to its sides in the axes
    without a move, zero in the others."""

    columns: np.ndarray
    moves: np.ndarray
    prior: np.ndarray
    room: np.ndarray


def movable(belief: Belief) -> tuple[str, ...]:
    """Effects whose place was found; that of the weight of a known load is where the load pulls."""
    return tuple(t.name for t in belief.terms if "place" in t.settings and "sequences" not in t.settings)


def place_of(belief: Belief, name: str) -> np.ndarray:
    """(3,) place of an effect in the published shape [m]."""
    return np.asarray(belief.term(name).settings["place"], float)


def moved(belief: Belief, name: str, place: np.ndarray) -> Belief:
    """The belief with an effect at another place (3,) [m]."""
    known = {k: v for k, v in belief.term(name).settings.items() if k not in CONCLUDED}
    settings = {**known, "place": np.asarray(place, float).tolist()}
    terms = tuple(replace(t, settings=settings) if t.name == name else t for t in belief.terms)
    return replace(belief, terms=terms)


def place_columns(problem: Problem, belief: Belief, name: str) -> PlaceColumns:
    """The derivative of a problem's residual by where an effect sits, in each axis that the material leaves
    room in. Raises SimulationError."""
    cell = problem.settings.spacing
    here = place_of(belief, name)
    sides = np.concatenate([here + SIDE * cell * np.eye(3), here - SIDE * cell * np.eye(3)])
    sides = closest_material(problem.capture.parts, sides).anchor
    columns, moves, room = [], [], np.zeros(3)
    for axis, (ahead, behind) in enumerate(zip(sides[:3], sides[3:], strict=True)):
        if np.linalg.norm(ahead - behind) < 2.0 * SIDE * THIN * cell:
            room[axis] = np.linalg.norm(ahead - behind)
            continue
        there, back = (
            problem.evaluate(moved(belief, name, place), jacobian=False).residual for place in (ahead, behind)
        )
        columns.append(there - back)
        moves.append(ahead - behind)
    count = len(problem.evaluate(belief, jacobian=False).residual)
    by = np.array(moves).reshape(-1, 3)
    return PlaceColumns(
        np.stack(columns, axis=1) if columns else np.zeros((count, 0)),
        by,
        object_size(problem.capture.parts) / np.linalg.norm(by, axis=1),
        room,
    )


def object_size(parts: Sequence[Part]) -> float:
    """Largest extent of the object [m]."""
    vertices = np.concatenate([part.vertices for part in parts])
    return float(np.ptp(vertices, axis=0).max())


def relocated(
    problem: Problem,
    solution: Solution,
    *,
    columns_of: Problem | None = None,
    iterations: int = 4,
    relative_tolerance: float = 1e-3,
    report: Callable[[str], None] | None = None,
) -> Solution:
    """A fit with the places of its effects fitted as well, by Gauss-Newton steps in which the materials give
    way, from where they are and from the middle of the material around; as it was where no place lowers the
    cost.

    columns_of: the same fit on a coarser grid that the derivatives by the place are taken from; iterations:
    of the fit of all else at each new place; relative_tolerance: as for `minimise`. Raises SimulationError.
    """
    for name in movable(solution.belief):
        found = walked(problem, solution, name, columns_of, iterations, relative_tolerance, report)
        inner = _deeper(problem, place_of(found.belief, name))
        try:
            other = minimise(
                problem,
                moved(found.belief, name, inner),
                iterations=iterations,
                relative_tolerance=relative_tolerance,
            )
            other = walked(problem, other, name, columns_of, iterations, relative_tolerance, report)
        except SimulationError:
            other = found
        worth = WORTH + relative_tolerance * found.evaluation.cost
        solution = other if other.evaluation.cost < found.evaluation.cost - worth else found
    return solution


def _deeper(problem: Problem, place: np.ndarray) -> np.ndarray:
    """(3,) middle of the material around a place. At the surface, whence moments are easily made, a place
    that is not its own may do nearly as well."""
    points = next(iter(problem.predictors.values())).body.quadrature.points.reshape(-1, 3)
    away = np.linalg.norm(points - place, axis=1)
    near = away < max(AROUND * problem.settings.spacing, 1.01 * away.min())
    return closest_material(problem.capture.parts, points[near].mean(0)[None]).anchor[0]


def walked(
    problem: Problem,
    solution: Solution,
    name: str,
    columns_of: Problem | None,
    iterations: int,
    relative_tolerance: float,
    report: Callable[[str], None] | None,
) -> Solution:
    """A fit with the place of one effect brought to the nearest minimum (see `relocated`)."""
    for _ in range(ROUNDS):
        try:
            found = place_columns(columns_of or problem, solution.belief, name)
        except SimulationError:
            break
        better = _step(problem, solution, name, found, relative_tolerance)
        if better is None:
            break
        start, before = solution.belief, solution.evaluation.cost
        solution = minimise(problem, better, iterations=iterations, relative_tolerance=relative_tolerance)
        further = _further(problem, start, solution, name)
        if further is not None:
            solution = minimise(
                problem, further, iterations=iterations, relative_tolerance=relative_tolerance
            )
        if report:
            at = ", ".join(f"{1e3 * x:.1f}" for x in place_of(solution.belief, name))
            report(f"{name} moved to ({at}) mm: {solution.evaluation.misfit:.3f} sigma")
        if before - solution.evaluation.cost < WORTH + relative_tolerance * before:
            break
    return solution


def _largest(belief: Belief, step: np.ndarray) -> float:
    """Of a step of the coordinates (P,), the largest of a logarithm."""
    return float(np.abs(step[[p.log for p in belief.free]]).max(initial=0.0))


def _further(problem: Problem, before: Belief, reached: Solution, name: str) -> Belief | None:
    """The belief so many times as far along a move of the place, twice as far each time, as the cost falls;
    None where it does not. Where a valley bends, steps by the derivative are short, and its floor is straight
    for longer than they tell."""
    coordinates = reached.belief.coordinates
    step, here = coordinates - before.coordinates, place_of(reached.belief, name)
    shift = here - place_of(before, name)
    best, cost, times = None, reached.evaluation.cost, 1.0
    while times * np.linalg.norm(shift) < LONGEST * problem.settings.spacing:
        if times * _largest(reached.belief, step) > LONGEST_COORDINATE:
            break
        place = closest_material(problem.capture.parts, (here + times * shift)[None]).anchor[0]
        trial = moved(reached.belief.at(coordinates + times * step), name, place)
        try:
            found = problem.evaluate(trial, jacobian=False).cost
        except SimulationError:
            break
        if found >= cost:
            break
        best, cost, times = trial, found, 2.0 * times
    return best


def _step(
    problem: Problem, solution: Solution, name: str, found: PlaceColumns, relative_tolerance: float
) -> Belief | None:
    """The belief after one step of the place and of all else, None where none lowers the cost enough."""
    evaluation, belief = solution.evaluation, solution.belief
    if not len(found.moves):
        return None
    both = np.hstack([evaluation.jacobian, found.columns])
    weight = np.r_[np.zeros(evaluation.jacobian.shape[1]), found.prior**-2.0]
    normal = both.T @ both
    normal += np.diag(weight + 1e-9 * np.maximum(np.diag(normal), 1e-12))
    step = -np.linalg.solve(normal, both.T @ evaluation.residual)
    p = evaluation.jacobian.shape[1]
    shift = step[p:] @ found.moves
    length = float(np.linalg.norm(shift)) / (LONGEST * problem.settings.spacing)
    step /= max(1.0, length, _largest(belief, step[:p]) / LONGEST_COORDINATE)
    promised = -(both.T @ evaluation.residual) @ step - 0.5 * step @ (both.T @ (both @ step))
    if promised < WORTH + relative_tolerance * evaluation.cost:
        return None
    for _ in range(1 + HALVINGS):
        place = place_of(belief, name) + step[p:] @ found.moves
        place = closest_material(problem.capture.parts, place[None]).anchor[0]
        trial = moved(belief.at(belief.coordinates + step[:p]), name, place)
        try:
            if problem.evaluate(trial, jacobian=False).cost < evaluation.cost:
                return trial
        except SimulationError:
            pass
        step = 0.5 * step
    return None
