"""The order of a fit: find the scale, follow the motion frame by frame, coarse grid first, then fine."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mphygs.capture.format import Capture
from mphygs.compare.noise import Observation
from mphygs.fit.levenberg_marquardt import Solution, minimise, report_of_iterations
from mphygs.fit.other_minima import beyond_crests, lower_along, lowest_of, other_minima
from mphygs.fit.part_scales import on_by_part
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.spacings import FINE, deciding_spacing, default_spacing
from mphygs.fit.stiffness_scale import find_scale, simulable
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.settings import Settings

COARSE_FACTOR = 1.5
# Of the default spacing: thin parts are lost on grids coarser than this.
COARSEST = 1.7
# A grid that is not so many times as coarse is hardly cheaper, and tells nothing of the finer one's error.
COARSER = 1.3
# What is tried on a coarse grid is not worth its last digits; above so many sigma it is not dwelt on: its
# first frames, where it is nearly right, will say why.
SCREENING_ACCURACY, TRACTABLE = 1e-3, 4.0
# Share of the cost that an iteration of a fit to tracks from pictures has to bring for another one: what
# errors tracks have of their own last from frame to frame, and leave far more open.
TRACKED_LEAST = 2e-3
# A model this far from the data [sigma] is fitted no further than a few iterations.
HOPELESS, HOPELESS_ITERATIONS = 5.0, 2
# How many iterations a stage takes, as far as progress is concerned, and how many refits the last one of an
# object of several parts takes to look for other minima: from one or two of a coarser grid, along the valley.
USUAL_ITERATIONS, SEARCHES = 5, 3
# Minima beyond the crests of a stiff part's valley that a fit is taken to.
BEYOND = 2
# A model that leaves so many times as much when it comes to a finer grid, and so many sigma, is brought
# onward there from its first frames: thin parts had other materials on the coarse one. Shares of the frames
# and iterations.
LOST, LOST_FROM = 2.0, 2.0
ONWARD = ((0.25, 6), (0.5, 4))


@dataclass(frozen=True)
class ScheduleStage:
    """One step of the schedule. share: of every range's frames; iterations: at most."""

    name: str
    spacing: float
    share: float
    iterations: int
    accuracy: float  # share of the cost that a last step may promise
    gross: float = np.inf  # misfit [sigma] that is not lowered for long where it hardly falls
    least: float = 0.0  # share of the cost that an iteration has to bring for another one
    reports: int = USUAL_ITERATIONS  # lines of progress to expect

    @property
    def work(self) -> float:
        """Cost relative to that of other stages: iterations times cells times substeps times frames."""
        return self.reports * self.share * self.spacing**-4


def stages(spacing: float, *, warm: bool, coarsest: float = np.inf) -> tuple[ScheduleStage, ...]:
    """Stages of a fit; a warm start knows the scale and needs the fine grid only.

    coarsest: spacing that the coarse stages may not exceed, unless the fine one does [m].
    """
    if warm:
        return (ScheduleStage("fine", spacing, 1.0, 12, 1e-4),)
    coarse = min(COARSE_FACTOR * spacing, coarsest)
    coarse = coarse if coarse >= COARSER * spacing else spacing
    plan = (
        ScheduleStage("coarse, first quarter", coarse, 0.25, 6, 3e-3),
        ScheduleStage("coarse, first half", coarse, 0.5, 4, 3e-3),
        ScheduleStage("coarse", coarse, 1.0, 6, 1e-3),
        ScheduleStage("fine", spacing, 1.0, 8, 1e-4),
    )
    # Where there is one grid only, its whole motion is fitted once.
    return plan if coarse > spacing else (*plan[:2], plan[3])


def plan_of(
    capture: Capture, spacing: float, *, warm: bool, screening: bool = False, searching: bool = True
) -> tuple[ScheduleStage, ...]:
    """The stages of a fit of a capture at a spacing [m]. screening: whether it is one of many models that are
    tried, where the grid is as coarse as that asks for; searching: whether the optimiser looks for other
    minima, which takes time."""
    # Rounded as spacings are: the coarsest grid is that of a screening fit, which has no other.
    plan = stages(spacing, warm=warm, coarsest=round(COARSEST * default_spacing(capture), 6))
    if searching and len(capture.parts) > 1:
        plan = (*plan[:-1], replace(plan[-1], reports=USUAL_ITERATIONS * (1 + SEARCHES)))
    if any(s.markers is not None and s.markers.spread is not None for s in capture.sequences):
        plan = tuple(replace(stage, least=TRACKED_LEAST) for stage in plan)
    if not screening or spacing <= FINE * deciding_spacing(capture):
        return plan
    return tuple(
        replace(stage, accuracy=max(stage.accuracy, SCREENING_ACCURACY), gross=TRACTABLE) for stage in plan
    )


def iterations_of(plan: Sequence[ScheduleStage]) -> float:
    """Iterations on the grid of the last stage that take about as long as a whole plan."""
    last = plan[-1]
    return last.reports * sum(stage.work for stage in plan) / last.work


def _brought_onward(
    problem: Problem, belief: Belief, before: float, tell: Callable[[int, Evaluation, Belief], None] | None
) -> Belief:
    """The belief fitted to the first frames, then to more of them, where it is lost on a problem's grid.

    before: misfit that it left on the grid it comes from [sigma]. Raises SimulationError.
    """
    if problem.evaluate(belief, jacobian=False).misfit < max(LOST * before, LOST_FROM):
        return belief
    start = belief
    try:
        for share, iterations in ONWARD:
            narrow = problem.narrowed(share)
            found = minimise(narrow, belief, iterations=iterations, report=tell, relative_tolerance=3e-3)
            belief = found.belief
    except SimulationError:
        return start
    return belief


def fit_belief(
    capture: Capture,
    belief: Belief,
    ranges: Mapping[str, tuple[int, int]],
    observations: Mapping[str, Observation],
    settings: Settings,
    *,
    warm: bool = False,
    report: Callable[[str], None] | None = None,
    aside: Callable[[str], None] | None = None,
    after_stage: Callable[[ScheduleStage, Solution], None] | None = None,
    start_stage: int = 0,
    before: tuple[Belief | None, float] = (None, 0.0),
    problems: dict[float, Problem] | None = None,
    plan: tuple[ScheduleStage, ...] | None = None,
) -> tuple[Solution, Problem]:
    """Run the schedule from a belief. Returns the last stage's solution and problem.

    ranges: frames to fit per sequence; settings.spacing is the fine spacing; warm: the belief is near its
    minimum already; aside: told, in place of report, of what is done on a coarser grid than the stage's, and
    takes less time; start_stage: first stage to run (resume); before: the belief of the stage before the
    last one that was run, if any, and the misfit that the last one left [sigma]; problems: cache by spacing,
    filled here; plan: stages in place of the usual ones.
    """
    plan = plan_of(capture, settings.spacing, warm=warm) if plan is None else plan
    problems = {} if problems is None else problems
    solution = None

    def problem_at(spacing: float) -> Problem:
        if spacing not in problems:
            problems[spacing] = Problem(capture, replace(settings, spacing=spacing), ranges, observations)
        return problems[spacing].with_ranges(ranges)

    (earlier, misfit), last = before, belief if start_stage else None
    for number, stage in enumerate(plan):
        if number < start_stage:
            continue
        problem = problem_at(stage.spacing).narrowed(stage.share)
        if number == 0 and not warm:
            belief = find_scale(problem, belief, report)

        tell = report_of_iterations(report, f"{stage.name} ({1e3 * stage.spacing:.3g} mm)")
        dwell = None
        if earlier is not None and misfit > HOPELESS:
            # What it became is of no use on another grid; the model before it is, and as wrong unless it was
            # the grid that could not carry it.
            belief, dwell = earlier, (HOPELESS_ITERATIONS, HOPELESS)
        belief = simulable(problem, belief)
        if number and stage.spacing < plan[number - 1].spacing:
            belief = _brought_onward(problem, belief, misfit, tell)
        given = {
            "iterations": stage.iterations,
            "relative_tolerance": stage.accuracy,
            "gross": stage.gross,
            "dwell": dwell,
            "least": stage.least,
        }
        again = partial(minimise, problem, report=tell, **given)
        solution = again(belief)
        if not warm and (number == 0 or stage.share > plan[number - 1].share):
            # Frames that no stage has seen may be the first to show what a part is like.
            solution = on_by_part(problem, solution, again, accuracy=stage.accuracy, say=report)
        if number and stage.share == plan[number - 1].share and misfit < HOPELESS:
            coarse = problem_at(plan[number - 1].spacing)
            others = other_minima(coarse, last, aside or report)
            solution = lowest_of(problem, solution, others, report, **given)
        if number + 1 == len(plan) and solution.evaluation.misfit < HOPELESS:
            beyond = beyond_crests(problem, solution, report)[:BEYOND]
            others = [*lower_along(problem, solution)[:1], *beyond]
            lower = lowest_of(problem, solution, others, report, **given)
            solution = replace(lower, start=solution.start)  # the minimum of the coarser grid is the same
        belief = solution.belief
        earlier, last, misfit = last, belief, solution.evaluation.misfit
        problems[stage.spacing].predictors.update(problem.predictors)
        if after_stage:
            after_stage(stage, solution)
    if solution is None:
        raise ValueError("start_stage is beyond the last stage")
    return solution, problem
