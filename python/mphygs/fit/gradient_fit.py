"""The fit's schedule with Adam or L-BFGS on the adjoint instead of Gauss-Newton on tangents."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from mphygs.capture.format import Capture
from mphygs.compare.noise import Observation
from mphygs.fit.gradient_optimisers import minimise_by_gradient
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.part_scales import on_by_part
from mphygs.fit.problem import Problem
from mphygs.fit.schedule import ScheduleStage, plan_of
from mphygs.fit.stiffness_scale import find_scale
from mphygs.model.belief import Belief
from mphygs.simulate.settings import Settings

# A stage takes at most this many gradients for each iteration of Gauss-Newton.
GRADIENTS = 12


def fit_by_gradient(
    capture: Capture,
    belief: Belief,
    ranges: Mapping[str, tuple[int, int]],
    observations: Mapping[str, Observation],
    settings: Settings,
    *,
    method: str,
    warm: bool = False,
    report: Callable[[str], None] | None = None,
    after_stage: Callable[[ScheduleStage, Solution], None] | None = None,
    start_stage: int = 0,
    problems: dict[float, Problem] | None = None,
    plan: tuple[ScheduleStage, ...] | None = None,
) -> Solution:
    """Run the stages of `fit_belief` with method "adam" or "lbfgs"; arguments as there.

    Raises SimulationError where the start cannot be simulated, ValueError for an unknown method.
    """
    problems = {} if problems is None else problems
    solution = None
    plan = plan_of(capture, settings.spacing, warm=warm) if plan is None else plan
    for number, stage in enumerate(plan):
        if number < start_stage:
            continue
        if stage.spacing not in problems:
            own = replace(settings, spacing=stage.spacing)
            problems[stage.spacing] = Problem(capture, own, ranges, observations)
        problem = problems[stage.spacing].with_ranges(ranges).narrowed(stage.share)
        if number == 0 and not warm:
            belief = find_scale(problem, belief, report)

        def tell(iteration: int, cost: float, _belief: Belief, stage: ScheduleStage = stage) -> None:
            if report and iteration % GRADIENTS == 0:
                report(f"{stage.name} ({1e3 * stage.spacing:.3g} mm): iteration {iteration}, cost {cost:.4g}")

        again = partial(
            minimise_by_gradient,
            problem,
            method=method,
            iterations=GRADIENTS * stage.iterations,
            relative_tolerance=stage.accuracy,
            report=tell,
        )
        solution = again(belief)
        if not warm and (number == 0 or stage.share > plan[number - 1].share):
            solution = on_by_part(problem, solution, again, accuracy=stage.accuracy, say=report)
        belief = solution.belief
        problems[stage.spacing].predictors.update(problem.predictors)
        if after_stage:
            after_stage(stage, solution)
    if solution is None:
        raise ValueError("start_stage is beyond the last stage")
    return solution
