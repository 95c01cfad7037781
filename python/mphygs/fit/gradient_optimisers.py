"""Adam and L-BFGS on the adjoint: for fits with many unknowns, where a Jacobian would cost too much.

The residuals are those of the Levenberg-Marquardt fit, priors and known mass included; one iteration costs
one adjoint run a sequence, whatever the number of parameters. Up to LARGEST_METRIC of them are searched for
in coordinates in which the cost at the start is round, from one Jacobian; more, in their own. Sources: Kingma
and Ba, "Adam: a method for stochastic optimization", 2015; Liu and Nocedal, "On the limited memory BFGS
method for large scale optimization", 1989; both as in torch.optim.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
import torch
from torch import Tensor

from mphygs.compare.noise import Observation
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction_gradient import predict_with_gradient

METHODS = ("adam", "lbfgs")
LARGEST_METRIC = 64
# Step of the first iterations; a distance of one in round coordinates changes the cost by half the start's.
LEARNING_RATES = {"adam": 0.1, "lbfgs": 1.0}
# Iterations over which the cost may stand still before the search ends.
PATIENCE = {"adam": 20, "lbfgs": 5}
# What a belief that cannot be simulated costs, in costs of the best one so far.
WALL = 10.0


@dataclass
class Misfit:
    """Half the sum of squares of one sequence's whitened markers in frames first..last-1."""

    observation: Observation
    first: int
    last: int
    cost: float = np.nan

    def slope(self, position: np.ndarray) -> np.ndarray:
        """Its derivative by the predicted positions, (T, M, 3); keeps the cost."""
        window = slice(self.first, self.last)
        whitener = self.observation.whitener(self.first, self.last)
        residual = whitener.whiten(np.nan_to_num(self.observation.position[window] - position[window]))
        self.cost = 0.5 * float(residual @ residual)
        out = np.zeros_like(position)
        out[window] = -whitener.whiten_transposed(residual)
        return out

    def reading_slopes(self, read: Sequence[np.ndarray]) -> list[np.ndarray]:
        """The derivatives by what its instruments read, (T, V, 3) each, of half their sum of squares, which
        is added to the cost."""
        found, window = [], slice(self.first, self.last)
        for sensor, value in zip(self.observation.sensors, read, strict=True):
            residual = sensor.residual(value, self.first, self.last)
            self.cost += 0.5 * float(residual @ residual)
            out = np.zeros_like(value)
            out[window] = -sensor.whitener(self.first, self.last).whiten_transposed(residual)
            found.append(out)
        return found


def cost_and_gradient(problem: Problem, belief: Belief) -> tuple[float, np.ndarray]:
    """Half the sum of squares of a problem's residuals, and its gradient (P,) by the free coordinates.

    The cost is `Problem.evaluate(belief).cost`; the gradient comes from the adjoint. Raises SimulationError
    where the belief cannot be simulated.
    """
    keys = tuple(p.key for p in belief.free)
    cost, gradient = 0.0, np.zeros(len(keys))
    for name, (first, last) in problem.ranges.items():
        misfit = Misfit(problem.observations[name], first, last)
        _, part = predict_with_gradient(
            problem.predictors[name], belief, misfit.slope, keys=keys, last=last, substep=problem.substep,
            reading_slopes=misfit.reading_slopes,
        )  # fmt: skip
        cost += misfit.cost
        gradient += part
    # Priors and the known mass: few rows, with their own Jacobian.
    residual, jacobian = problem.prior_rows(belief)
    cost += 0.5 * float(residual @ residual)
    gradient += jacobian.T @ residual
    if not np.isfinite(cost) or not np.isfinite(gradient).all():
        raise SimulationError("the prediction or its gradient is not finite")
    return cost, gradient


@dataclass
class Objective:
    """What the optimisers see: cost and gradient per cost unit, with bounds and a wall where nothing runs.

    measure: cost and gradient (P,) by the free coordinates at a belief; belief: where the search begins;
    unit: what one unit of cost is; axes: (P, P), coordinates = those of the belief + axes @ point;
    best, at_best: the least cost that was met, and its coordinates (P,).
    """

    measure: Callable[[Belief], tuple[float, np.ndarray]]
    belief: Belief
    unit: float
    axes: np.ndarray
    best: float = np.inf
    at_best: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def within(self, point: np.ndarray) -> np.ndarray:
        """The point moved into the bounds."""
        inside = self.belief.at(self.belief.coordinates + self.axes @ point).coordinates
        return np.linalg.solve(self.axes, inside - self.belief.coordinates)

    def __call__(self, point: np.ndarray) -> tuple[float, np.ndarray]:
        coordinates = self.belief.coordinates + self.axes @ point
        moved = self.belief.at(coordinates)
        inside = moved.coordinates
        try:
            cost, gradient = self.measure(moved)
        except SimulationError:
            if not np.isfinite(self.best):
                raise
            away = point - np.linalg.solve(self.axes, self.at_best - self.belief.coordinates)
            height = WALL * self.best / self.unit
            return height, height * away / max(float(away @ away), 1e-24)
        if cost < self.best:
            self.best, self.at_best = cost, inside
        # Beyond a bound the cost is that of the bound: there it is flat.
        slope = np.where(np.abs(inside - coordinates) > 1e-9, 0.0, gradient)
        return cost / self.unit, self.axes.T @ slope / self.unit


def minimise_by_gradient(
    problem: Problem,
    belief: Belief,
    *,
    method: str,
    iterations: int = 200,
    learning_rate: float | None = None,
    tolerance: float = 0.05,
    relative_tolerance: float = 1e-4,
    report: Callable[[int, float, Belief], None] | None = None,
) -> Solution:
    """Minimise half the sum of squares of a problem over the free parameters of a belief.

    method: "adam" or "lbfgs"; iterations: at most; learning_rate: None takes that of LEARNING_RATES, and Adam
    lowers it to zero along a cosine; tolerance, relative_tolerance: stop when the best cost falls by less
    than tolerance (in units of a squared standard deviation) plus this share of it, over as many iterations
    as PATIENCE says; report: called with iteration, best cost and its belief. The evaluation of the solution
    holds the Jacobian at the best belief that was met.

    Raises ValueError for an unknown method, SimulationError when even the starting belief cannot be
    simulated.
    """
    if method not in METHODS:
        raise ValueError(f"method '{method}': expected one of {', '.join(METHODS)}")
    if not belief.free:
        raise ValueError("minimise_by_gradient: expected a belief with free parameters")
    options = (method, iterations, learning_rate, tolerance, relative_tolerance, report)
    found, history, converged, reason = _search(problem, belief, *options)
    held = [p.key for p in found.free if p.at_bound]
    left = iterations + 1 - len(history)
    if held and left > 0 and len(held) < len(found.free):
        # Where the gradient is cut off at a bound the search creeps: once more, with what stands there held.
        for key in held:
            found = found.with_parameter(key, free=False)
        again = (method, left, learning_rate, tolerance, relative_tolerance, report)
        found, more, converged, reason = _search(problem, found, *again)
        # What was known of them beforehand no longer counts there: the same at every point.
        history += [history[-1] + cost - more[0] for cost in more[1:]]
        for key in held:
            found = found.with_parameter(key, free=True)
    return Solution(found, problem.evaluate(found), tuple(history), converged, reason)


def _search(
    problem: Problem,
    belief: Belief,
    method: str,
    iterations: int,
    learning_rate: float | None,
    tolerance: float,
    relative_tolerance: float,
    report: Callable[[int, float, Belief], None] | None,
) -> tuple[Belief, list[float], bool, str]:
    """The best belief of one search, the costs on the way, whether it converged, and why it ended."""
    count = len(belief.free)
    first = problem.evaluate(belief, jacobian=count <= LARGEST_METRIC)
    # In units of the starting cost: the first gradients are then of order one whatever the noise.
    start = first.cost
    unit = max(start, 1e-300)
    axes = np.eye(count)
    if count <= LARGEST_METRIC:
        # Directions that the data hardly feel are kept from growing without bound.
        square = first.jacobian.T @ first.jacobian
        root = np.linalg.cholesky(
            square + 1e-6 * np.diag(np.diag(square)) + 1e-12 * np.trace(square) * np.eye(count)
        )
        axes = np.sqrt(unit) * np.linalg.inv(root).T
    # The adjoint's cost of the same belief differs in the last digit: the start's own is the one to beat.
    objective = Objective(partial(cost_and_gradient, problem), belief, unit, axes, start, belief.coordinates)
    point = torch.zeros(count, dtype=torch.float64, requires_grad=True)
    rate = LEARNING_RATES[method] if learning_rate is None else learning_rate
    schedule = None
    if method == "adam":
        optimiser: torch.optim.Optimizer = torch.optim.Adam([point], lr=rate)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, iterations)
    else:
        optimiser = torch.optim.LBFGS(
            [point], lr=rate, max_iter=1, max_eval=25, history_size=max(10, min(count, 50)),
            line_search_fn="strong_wolfe", tolerance_grad=0.0, tolerance_change=0.0,
        )  # fmt: skip

    def closure() -> Tensor:
        cost, gradient = objective(point.detach().numpy())
        point.grad = torch.from_numpy(gradient)
        return torch.tensor(cost, dtype=torch.float64)

    history, converged, reason = [start], False, "iterations used up"
    for iteration in range(1, iterations + 1):
        optimiser.step(closure)
        if schedule is not None:
            schedule.step()
        with torch.no_grad():
            point.copy_(torch.from_numpy(objective.within(point.detach().numpy())))
        history.append(objective.best)
        if report:
            report(iteration, objective.best, belief.at(objective.at_best))
        wait = PATIENCE[method]
        if (
            iteration > wait
            and history[-1 - wait] - history[-1] < tolerance + relative_tolerance * history[-1]
        ):
            converged, reason = True, "converged"
            break
    return belief.at(objective.at_best), history, converged, reason
