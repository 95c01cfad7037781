"""The order of a fit: find the scale, follow the motion frame by frame, coarse grid first, then fine."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from mphygs.capture.format import Capture
from mphygs.compare.noise import Observation
from mphygs.fit.levenberg_marquardt import Solution, minimise, report_of_iterations
from mphygs.fit.other_minima import lower_along, lowest_of, other_minima
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.settings import Settings

# Cells that an object of default spacing is worth: about 250 of its volume.
DEFAULT_CELLS = 250
# Cells of material, eight points each, that tens of gigabytes hold.
MOST_CELLS = 2e6
COARSE_FACTOR = 1.5
# Of the default spacing: thin parts are lost on grids coarser than this.
COARSEST = 1.7
# Of the default spacing: where many models are tried, and where those that are left are decided between.
SCREENING_FACTOR, DECIDING_FACTOR = 1.7, 1.28
# What is tried on a coarse grid is not worth its last digits; above so many sigma it is not dwelt on: its
# first frames, where it is nearly right, will say why.
SCREENING_ACCURACY, TRACTABLE = 1e-3, 4.0
# Share of the cost that an iteration of a fit to tracks from pictures has to bring for another one: what
# errors tracks have of their own last from frame to frame, and leave far more open.
TRACKED_LEAST = 2e-3
# A grid within this factor of the deciding one is no screening grid.
FINE = 1.1
# A model this far from the data [sigma] is fitted no further than a few iterations.
HOPELESS, HOPELESS_ITERATIONS = 5.0, 2
# How far any part's stiffness may be from the common scale that was found: without a bound a model that
# lacks an effect makes a part of jelly that its own weight crushes.
CONTRAST = 40.0
# So many times the stiffest other part: what is beyond may be a coarse grid's own.
FAR_STIFFER = 2.0
# How many iterations a stage takes, as far as progress is concerned.
USUAL_ITERATIONS = 5
# A rest shape that has to be solved for takes long where it is too soft: after so many factors in a row that
# are worse than the best, softer ones are not tried.
PATIENCE = 2
# A model that leaves so many times as much when it comes to a finer grid, and so many sigma, is brought
# onward there from its first frames: thin parts had other materials on the coarse one. Shares of the frames
# and iterations.
LOST, LOST_FROM = 2.0, 2.0
ONWARD = ((0.25, 6), (0.5, 4))
# Common factors on all Young's moduli that are tried before anything else; share of the cost by which one
# beyond these has to be better than the one before.
SCALES, BETTER = tuple(10.0**k for k in (-1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5)), 0.01
# Between two of them half a swing of the motion may fit, and the valley with it: it is looked for halfway
# beside all that cost up to so many times the least, and once more beside the best of these.
HARDLY_WORSE = 2.0


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
        """Cost relative to that of other stages: cells times substeps times frames."""
        return self.share * self.spacing**-4


def default_spacing(capture: Capture) -> float:
    """Grid spacing that gives about DEFAULT_CELLS full cells of material [m], two digits."""
    volume = sum(part.volume for part in capture.parts)
    spacing = (volume / DEFAULT_CELLS) ** (1.0 / 3.0)
    digits = 10.0 ** (np.floor(np.log10(spacing)) - 1)
    return float(np.round(spacing / digits) * digits)


def check_spacing(capture: Capture, spacing: float, where: str) -> None:
    """Raises ValueError, beginning with `where`, for a grid of more cells than fit into memory."""
    finest = (sum(part.volume for part in capture.parts) / MOST_CELLS) ** (1.0 / 3.0)
    if spacing < finest:
        raise ValueError(
            f"{where}: got {spacing:g} m; expected {finest:.2g} m or more, {MOST_CELLS:.0e} cells of material"
        )


def screening_spacing(capture: Capture) -> float:
    """Coarser spacing for trying many models one after the other [m]: a sixth of the work of the default."""
    return round(SCREENING_FACTOR * default_spacing(capture), 6)


def deciding_spacing(capture: Capture) -> float:
    """Spacing at which models are judged and decided between [m]: 0.3 to 0.6 of the work of the default."""
    return round(DECIDING_FACTOR * default_spacing(capture), 6)


def stages(spacing: float, *, warm: bool, coarsest: float = np.inf) -> tuple[ScheduleStage, ...]:
    """Stages of a fit; a warm start knows the scale and needs the fine grid only.

    coarsest: spacing that the coarse stages may not exceed, unless the fine one does [m].
    """
    if warm:
        return (ScheduleStage("fine", spacing, 1.0, 12, 1e-4),)
    coarse = max(spacing, min(COARSE_FACTOR * spacing, coarsest))
    plan = (
        ScheduleStage("coarse, first quarter", coarse, 0.25, 6, 3e-3),
        ScheduleStage("coarse, first half", coarse, 0.5, 4, 3e-3),
        ScheduleStage("coarse", coarse, 1.0, 6, 1e-3),
        ScheduleStage("fine", spacing, 1.0, 8, 1e-4),
    )
    # Where there is one grid only, its whole motion is fitted once.
    return plan if coarse > spacing else (*plan[:2], plan[3])


def plan_of(
    capture: Capture, spacing: float, *, warm: bool, screening: bool = False
) -> tuple[ScheduleStage, ...]:
    """The stages of a fit of a capture at a spacing [m]. screening: whether it is one of many models that are
    tried, where the grid is as coarse as that asks for."""
    # Rounded as spacings are: the coarsest grid is that of a screening fit, which has no other.
    plan = stages(spacing, warm=warm, coarsest=round(COARSEST * default_spacing(capture), 6))
    if any(s.markers is not None and s.markers.spread is not None for s in capture.sequences):
        plan = tuple(replace(stage, least=TRACKED_LEAST) for stage in plan)
    if not screening or spacing <= FINE * deciding_spacing(capture):
        return plan
    return tuple(
        replace(stage, accuracy=max(stage.accuracy, SCREENING_ACCURACY), gross=TRACTABLE) for stage in plan
    )


def with_materials_at_prior(belief: Belief) -> Belief:
    """The belief with its free materials back at the middle of their priors, within the bounds that they had
    before a scale was found."""
    parameters = []
    for p in belief.parameters:
        if p.free and p.log and np.isfinite(p.prior_std) and p.key.rsplit(".", 1)[0] in belief.parts:
            p = p.widened()
            p = replace(p, value=float(np.clip(np.exp(p.prior_mean), p.lower, p.upper)))
        parameters.append(p)
    return replace(belief, parameters=tuple(parameters))


def stiffened(belief: Belief, factor: float) -> Belief:
    """The belief with all free Young's moduli times a factor, as far as their bounds allow."""
    for p in belief.free:
        if p.key.endswith(".youngs_modulus"):
            belief = belief.with_parameter(p.key, value=min(max(p.value * factor, p.lower), p.upper))
    return belief


def without_stiffest(belief: Belief) -> Belief | None:
    """The belief with the part in which waves are fastest, where it is far stiffer than every other, as stiff
    as the others are in the mean; None where no part is, or none of it is free.

    A coarse grid hides how a thick part bends: there it may turn into stone and fit as well.
    """
    moduli = {name: belief[f"{name}.youngs_modulus"] for name in belief.parts}
    if len(moduli) < 2:
        return None
    speed = {name: p.value / belief[f"{name}.density"].value for name, p in moduli.items()}
    fastest = max(speed, key=speed.__getitem__)
    others = [p.value for name, p in moduli.items() if name != fastest]
    stiffest = moduli[fastest]
    if not stiffest.free or stiffest.value < FAR_STIFFER * max(others):
        return None
    value = float(np.exp(np.mean(np.log(others))))
    return belief.with_parameter(stiffest.key, value=min(max(value, stiffest.lower), stiffest.upper))


def about_its_scale(belief: Belief) -> Belief:
    """The belief with each free Young's modulus kept within CONTRAST of where it is."""
    return replace(
        belief,
        parameters=tuple(
            p.narrowed(CONTRAST) if p.free and p.key.endswith(".youngs_modulus") else p
            for p in belief.parameters
        ),
    )


def at_scales(
    problem: Problem, belief: Belief, *, near: float = 1.0
) -> Iterator[tuple[float, float, Belief]]:
    """Common factors on all free Young's moduli, from stiff to soft, with the cost and the belief there;
    those that cannot be simulated left out.

    near: cost over the least so far from which a factor counts as worse (see PATIENCE).
    """
    least, worse = np.inf, 0
    for scale in sorted(SCALES, reverse=True):
        if np.isfinite(least) and worse >= PATIENCE and belief.prestress == "equilibrium":
            return
        worse += 1
        trial = stiffened(belief, scale)
        try:
            cost = problem.evaluate(trial, jacobian=False).cost
        except SimulationError:
            continue
        if cost < near * least:
            worse = 0
        least = min(least, cost)
        yield scale, cost, trial


def find_scale(problem: Problem, belief: Belief, report: Callable[[str], None] | None = None) -> Belief:
    """Move all free Young's moduli together to the factor that fits the first frames best: of the usual
    scales, beyond them as long as that fits better still, within their bounds, and of those between."""
    best, best_cost, at = None, np.inf, 1.0
    seen: dict[float, float] = {}

    def tried(scale: float, cost: float, trial: Belief) -> bool:
        nonlocal best, best_cost, at
        if report:
            report(f"scale {scale:.3g}: cost {cost:.4g}")
        seen[scale] = cost
        better = cost < (1.0 - BETTER) * best_cost
        if cost < best_cost:
            best, best_cost, at = trial, cost, scale
        return better

    for scale, cost, trial in at_scales(problem, belief):
        tried(scale, cost, trial)
    if best is None:
        raise SimulationError(
            f"no stiffness from {min(SCALES):.2g} to {max(SCALES):.2g} times the usual one could be "
            "simulated from the start"
        )
    step = SCALES[1] / SCALES[0]
    onward = step if at == max(seen) else 1.0 / step if at == min(seen) else None
    moved = best
    while onward is not None:
        trial = stiffened(moved, onward)
        if trial.free == moved.free:
            break  # at its bounds
        try:
            better = tried(at * onward, problem.evaluate(trial, jacobian=False).cost, trial)
        except SimulationError:
            break
        if not better:
            break
        moved = trial
    for apart, worse in ((step**0.5, HARDLY_WORSE), (step**0.25, 1.0)):
        near = [scale for scale, cost in seen.items() if cost <= worse * best_cost]
        for scale in sorted({round(scale * f, 9) for scale in near for f in (apart, 1.0 / apart)}):
            trial = stiffened(belief, scale)
            with suppress(SimulationError):
                tried(scale, problem.evaluate(trial, jacobian=False).cost, trial)
    return about_its_scale(best)


def simulable(problem: Problem, belief: Belief) -> Belief:
    """The belief, stiffened where another grid cannot carry what the grid before it could.

    Raises SimulationError when a factor of 64 does not help.
    """
    for factor in (1.0, 1.3, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0):
        trial = stiffened(belief, factor)
        try:
            problem.evaluate(trial, jacobian=False)
        except SimulationError as error:
            failure = error
            continue
        return trial
    raise failure


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
    after_stage: Callable[[ScheduleStage, Solution], None] | None = None,
    start_stage: int = 0,
    before: tuple[Belief | None, float] = (None, 0.0),
    problems: dict[float, Problem] | None = None,
    plan: tuple[ScheduleStage, ...] | None = None,
) -> tuple[Solution, Problem]:
    """Run the schedule from a belief. Returns the last stage's solution and problem.

    ranges: frames to fit per sequence; settings.spacing is the fine spacing; warm: the belief is near its
    minimum already; start_stage: first stage to run (resume); before: the belief of the stage before the
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
        solution = minimise(problem, belief, report=tell, **given)
        if number and stage.share == plan[number - 1].share and misfit < HOPELESS:
            coarse = problem_at(plan[number - 1].spacing)
            solution = lowest_of(problem, solution, other_minima(coarse, last), report, **given)
        if number + 1 == len(plan) and solution.evaluation.misfit < HOPELESS:
            lower = lowest_of(problem, solution, lower_along(problem, solution)[:1], report, **given)
            solution = replace(lower, start=solution.start)  # the minimum of the coarser grid is the same
        belief = solution.belief
        earlier, last, misfit = last, belief, solution.evaluation.misfit
        problems[stage.spacing].predictors.update(problem.predictors)
        if after_stage:
            after_stage(stage, solution)
    if solution is None:
        raise ValueError("start_stage is beyond the last stage")
    return solution, problem
