"""The paper's fit: Adam on the adjoint, over windows that begin in mid-motion and then over all frames.

A model with an effect that remembers simulates what was before a window as well.

The loss is the paper's L_3D, the squared distance of predicted and measured points, over twice the variance
of a coordinate's noise, so that priors weigh what they weigh in every fit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch

from mphygs.capture.format import Capture
from mphygs.compare.noise import Observation
from mphygs.fit.gradient_optimisers import Objective
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.paper_plan import (
    ITERATIONS,
    REPORT_EVERY,
    PaperStage,
    check_windows,
    paper_plan,
    remembers,
    window_frames,
)
from mphygs.fit.problem import Problem
from mphygs.fit.window_start import start_at
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import Settings
from mphygs.simulate.transfer import Start

# Of Adam, in coordinates (logarithms of materials); it falls to zero along a cosine within a stage.
LEARNING_RATE = 0.1


@dataclass(frozen=True, eq=False)
class _Window:
    """Frames [first, last) of one sequence, simulated from a state in mid-motion or (None) from rest."""

    predictor: Predictor
    observation: Observation
    start: Start | None
    first: int
    last: int

    def measure(self, belief: Belief, keys: tuple[str, ...], substep: float) -> tuple[float, np.ndarray]:
        """L_3D over twice the noise's variance, and its gradient by the coordinates of `keys`."""
        origin = 0 if self.start is None else self.start.frame
        seen = self.observation.observed[self.first : self.last, :, None]
        measured = self.observation.position[self.first : self.last]
        cost = 0.0

        def slope(position: np.ndarray) -> np.ndarray:
            nonlocal cost
            inside = slice(self.first - origin, self.last - origin)
            apart = np.where(seen, position[inside] - measured, 0.0) / self.observation.sigma
            cost = 0.5 * float((apart * apart).sum())
            out = np.zeros_like(position)
            out[inside] = apart / self.observation.sigma
            return out

        _, gradient = predict_with_gradient(
            self.predictor, belief, slope, keys=keys, last=self.last, substep=substep, start=self.start
        )
        return cost, gradient


@dataclass(frozen=True, eq=False)
class _Batch:
    """The windows of one stage; gradients add into the shared parameters."""

    problem: Problem
    windows: tuple[_Window, ...]

    @classmethod
    def of(cls, problem: Problem, stage: PaperStage, *, from_rest: bool = False) -> _Batch:
        windows = []
        for name, span in problem.ranges.items():
            predictor, observation = problem.predictors[name], problem.observations[name]
            for at, first, last in window_frames(
                stage, span, predictor.recording.release, from_rest=from_rest
            ):
                start = None if at is None else start_at(predictor, observation, at)
                windows.append(_Window(predictor, observation, start, first, last))
        return cls(problem, tuple(windows))

    def measure(self, belief: Belief) -> tuple[float, np.ndarray]:
        """Cost and gradient (P,) by the free coordinates, priors included."""
        keys = tuple(p.key for p in belief.free)
        substeps = {id(w.predictor): 0.0 for w in self.windows}
        for window in self.windows:
            if not substeps[id(window.predictor)]:
                substeps[id(window.predictor)] = window.predictor.stable_substep(belief)

        def work(window: _Window) -> tuple[float, np.ndarray]:
            return window.measure(belief, keys, substeps[id(window.predictor)])

        workers = min(self.problem.settings.workers, len(self.windows))
        # A rest shape that is solved for keeps one factorisation, which windows share.
        if workers > 1 and belief.prestress != "equilibrium":
            shared = {window.predictor: window.predictor.workers for window in self.windows}
            try:
                for predictor in shared:
                    predictor.workers = 1
                with ThreadPoolExecutor(workers) as pool:
                    found = list(pool.map(work, self.windows))
            finally:
                for predictor, cores in shared.items():
                    predictor.workers = cores
        else:
            found = [work(window) for window in self.windows]
        residual, jacobian = self.problem.prior_rows(belief)
        cost = sum(c for c, _ in found) + 0.5 * float(residual @ residual)
        gradient = sum((g for _, g in found), jacobian.T @ residual)
        if not np.isfinite(cost) or not np.isfinite(gradient).all():
            raise SimulationError("the prediction or its gradient is not finite")
        return cost, gradient


def adam(
    measure: Callable[[Belief], tuple[float, np.ndarray]],
    belief: Belief,
    tell: Callable[[int, float], None],
) -> tuple[Belief, list[float]]:
    """The best belief that Adam meets in a stage, and the least cost after every iteration.

    measure: cost and gradient (P,) by the free coordinates. Raises SimulationError where the belief cannot be
    simulated.
    """
    count = len(belief.free)
    objective = Objective(measure, belief, 1.0, np.eye(count))
    point = torch.zeros(count, dtype=torch.float64, requires_grad=True)
    optimiser = torch.optim.Adam([point], lr=LEARNING_RATE)
    rate = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, ITERATIONS)
    history: list[float] = []
    for iteration in range(1, ITERATIONS + 1):
        _, gradient = objective(point.detach().numpy())
        point.grad = torch.from_numpy(gradient)
        optimiser.step()
        rate.step()
        with torch.no_grad():
            point.copy_(torch.from_numpy(objective.within(point.detach().numpy())))
        history.append(objective.best)
        if iteration % REPORT_EVERY == 0:
            tell(iteration, objective.best)
    return belief.at(objective.at_best), history


def fit_by_windows(
    capture: Capture,
    belief: Belief,
    ranges: Mapping[str, tuple[int, int]],
    observations: Mapping[str, Observation],
    settings: Settings,
    *,
    report: Callable[[str], None] | None = None,
    after_stage: Callable[[PaperStage, Solution], None] | None = None,
    start_stage: int = 0,
    problems: dict[float, Problem] | None = None,
    plan: tuple[PaperStage, ...] | None = None,
) -> Solution:
    """Run the paper's stages from a belief; arguments as those of `fit_belief`.

    The evaluation of every stage's solution is that of all frames; the last one's has the Jacobian.
    Raises SimulationError where the start cannot be simulated, ValueError for an effect that windows cannot
    fit, or where too few markers are seen to begin one.
    """
    check_windows(belief.effects)
    problems = {} if problems is None else problems
    if settings.spacing not in problems:
        problems[settings.spacing] = Problem(capture, settings, ranges, observations)
    problem = problems[settings.spacing].with_ranges(ranges)
    from_rest = remembers(belief.effects)
    plan = paper_plan(settings.spacing, ranges, from_rest=from_rest) if plan is None else plan
    solution = None
    for number, stage in enumerate(plan):
        if number < start_stage:
            continue

        def tell(iteration: int, cost: float, stage: PaperStage = stage) -> None:
            if report:
                report(f"{stage.name}: iteration {iteration} of {ITERATIONS}, cost {cost:.4g}")

        belief, history = adam(_Batch.of(problem, stage, from_rest=from_rest).measure, belief, tell)
        evaluation = problem.evaluate(belief, jacobian=number + 1 == len(plan))
        solution = Solution(belief, evaluation, tuple(history), True, "iterations done")
        if after_stage:
            after_stage(stage, solution)
    if solution is None:
        raise ValueError("start_stage is beyond the last stage")
    return solution
