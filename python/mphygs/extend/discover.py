"""The whole loop: assimilate, score, refit, judge, release; until the error is explained or nothing pays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

from mphygs.compare.assess import Compared
from mphygs.compare.noise import Observation
from mphygs.compare.roughness import doubted_sigma
from mphygs.diagnose.criteria import CRITERIA, Criteria
from mphygs.diagnose.outliers import bad_observations
from mphygs.diagnose.ranking import Ranking, ranking_of
from mphygs.extend.contend import FAILURES, Contender, predictive
from mphygs.extend.rounds import (
    Beside,
    Round,
    assimilated,
    gains_of,
    held_round,
    simplest,
    table_of,
)
from mphygs.extend.step import FAULT, Step, excess, from_grid_to_grid, known_budget
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.schedule import simulable
from mphygs.fit.side_by_side import side_by_side
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

# So much of the noise or less in every range says that the noise is stated too large.
FAR_LESS = 0.5
# Iterations of what is decided on, and of what is concluded.
DECIDING, CONCLUDING = 4, 8


@dataclass(frozen=True, eq=False)
class Discovery:
    """verdict: adequate, missing, unknown or measurement; effects: concluded, most certain first; table: one
    row a candidate of the last round."""

    verdict: str
    effects: tuple[str, ...]
    steps: tuple[Step, ...]
    rankings: tuple[Ranking, ...]
    warnings: tuple[str, ...] = field(default_factory=tuple)
    table: tuple[dict, ...] = ()


def mask_outliers(experiment: Experiment, compared: dict[str, Compared]) -> int:
    """Leave bad tracks out of all observations. Returns the number of measurements left out."""
    total = 0
    for name, item in compared.items():
        first, last = item.frames
        residual = item.observation.position * float("nan")
        residual[first:last] = item.observation.position[first:last] - item.predicted[first:last]
        markers = experiment.capture.sequence(name).markers
        bad = bad_observations(residual, markers.at, item.observation.sigma)
        # Frames outside the compared ranges keep what they have.
        count = int((bad & item.observation.observed).sum())
        if count:
            position = item.observation.position.copy()
            position[bad] = float("nan")
            experiment.observations[name] = Observation(
                position, item.observation.noise, item.observation.weight
            )
            total += count
    return total


@dataclass(frozen=True)
class Grids:
    """Spacings [m]. trying: of the grid on which many models are tried; deciding: of the one that decides."""

    trying: float
    deciding: float


def settled(
    experiment: Experiment,
    belief: Belief,
    grids: Grids,
    *,
    iterations: int = DECIDING,
    jacobian: bool = False,
) -> tuple[Solution, dict[str, Compared]]:
    """A free fit on the grid that decides, led by Jacobians of the coarse one. Raises SimulationError."""
    problem = experiment.problem(grids.deciding)
    lender = experiment.problem(grids.trying) if grids.deciding < grids.trying else None
    solution = minimise(
        problem, simulable(problem, belief), iterations=iterations, relative_tolerance=3e-4, lender=lender
    )
    return solution, experiment.compare(solution.belief, grids.deciding, jacobian=jacobian)


def told(
    experiment: Experiment,
    solution: Solution,
    coarse: Belief | None,
    grids: Grids,
    *,
    added: Sequence[str] = (),
    ties: Sequence[str] = (),
    table: tuple[dict, ...] = (),
) -> Step:
    """A free model on the grid that decides as a step, the discretisation's share measured for it."""
    fine = grids.deciding
    beside = grids.trying if grids.trying > fine else None
    compared = experiment.compare(solution.belief, fine, refine=True, beside=beside)
    moved = {} if coarse is None else from_grid_to_grid(coarse, solution.belief, grids.trying / fine)
    return Step(
        solution.belief, solution, compared, experiment.assess(compared), fine, tuple(added), tuple(ties),
        beside=beside, moved=moved, table=table, gain=0.0,
    )  # fmt: skip


def is_free(beside: Beside, criteria: Criteria) -> bool:
    """Whether a model is near the data without feedback."""
    return beside.gain == 0.0 and beside.predictive.misfit[0] < criteria.near


def step_of(
    experiment: Experiment, beside: Beside, grids: Grids, criteria: Criteria, **more: object
) -> Step:
    """A model as it is told: free; on the grid that decides where it is near the data without feedback."""
    if is_free(beside, criteria):
        solution, _ = settled(experiment, beside.belief, grids)
        return told(experiment, solution, beside.belief, grids, **more)
    solution = beside.solution
    try:
        compared = experiment.compare(solution.belief, grids.trying)
    except FAILURES:
        # What cannot run free is told as it is under feedback.
        compared = experiment.compare(solution.belief, grids.trying, gain=beside.gain)
    return Step(
        solution.belief, solution, compared, experiment.assess(compared), grids.trying, gain=beside.gain,
        **more,
    )  # fmt: skip


def decided(
    experiment: Experiment,
    round_: Round,
    grids: Grids,
    criteria: Criteria,
    say: Callable[[str], None],
) -> Step | None:
    """The winner of a round, free, on the grid that decides; None where there is none."""
    finalists = round_.finalists
    if not finalists:
        return None
    if not round_.free:
        # More is missing: only feedback tells them apart.
        scores = [(t.belief, t.effect, t.predictive) for t in finalists]
        number, ties = simplest(scores, criteria.grid, criteria)
        t = finalists[number]
        return step_of(
            experiment, Beside(t.solution, t.predictive, round_.beside.gain), grids, criteria,
            added=(t.effect,), ties=ties, table=table_of(round_, t.effect, ties),
        )  # fmt: skip

    def settle(own: Experiment, t: Contender) -> tuple[Solution, dict[str, Compared]] | str:
        try:
            return settled(own, t.free.belief, grids)
        except FAILURES as error:
            return str(error).splitlines()[0]

    done = side_by_side(experiment, settle, finalists)
    running = [(t, d) for t, d in zip(finalists, done, strict=True) if not isinstance(d, str)]
    if not running:
        return None
    scores = [(d[0].belief, t.effect, predictive(d[1], criteria)) for t, d in running]
    for _, name, score in scores:
        say("  {} on the grid that decides: {:.3f} sigma fitted, {:.3f} unseen".format(name, *score.misfit))
    # The error falls with the square of the spacing, its square with the fourth power.
    share = max(round_.share, criteria.grid) * (grids.deciding / grids.trying) ** 4
    number, ties = simplest(scores, share, criteria)
    t, (solution, _) = running[number]
    return told(
        experiment, solution, t.free.belief, grids,
        added=(t.effect,), ties=ties, table=table_of(round_, t.effect, ties),
    )  # fmt: skip


def discover(
    experiment: Experiment,
    belief: Belief,
    spacing: float,
    *,
    fine: float | None = None,
    seed: int = 0,
    names: Sequence[str] | None = None,
    start: Sequence[Step] = (),
    criteria: Criteria = CRITERIA,
    report: Callable[[str], None] | None = None,
    on_step: Callable[[Step, Sequence[Ranking]], None] | None = None,
) -> Discovery:
    """Find what is missing from a model of a capture.

    belief: the model to start from, not yet fitted; spacing: of the grid on which many models are tried; what
    is concluded stands on a finer one, `fine` [m] (None: the same); names: effects that may be added (None:
    all); start: steps that are done already, the first model the first of them; on_step: told every new step,
    and the rankings so far, as soon as it is done.
    Raises SimulationError when not even the first model can be simulated.
    """
    say = report or (lambda _text: None)
    grids = Grids(spacing, spacing if fine is None else min(fine, spacing))
    steps, rankings = list(start), []
    table: tuple[dict, ...] = ()

    def done(step: Step) -> None:
        steps.append(step)
        what = ", ".join(step.added) or "the first model"
        say(f"{what}: {step.assessment.worst:.3f} sigma in the worst range")
        if on_step:
            on_step(step, rankings)

    def begun(step: Step | None) -> Beside:
        """A model beside the measurement, from its step alone: a loop that was stopped goes on as if it had
        not been."""
        for problem in experiment.problems.values():
            for predictor in problem.predictors.values():
                predictor.forget()
        start = belief if step is None else step.belief
        first = gains_of(experiment)[0] if step is None else step.gain
        start = simulable(experiment.problem(spacing).under(first), start)
        return assimilated(experiment, start, spacing, first=first, criteria=criteria, say=say)

    masks = names is None or FAULT in names
    masks = masks and not any(FAULT in step.added for step in steps)
    now = begun(steps[-1] if steps else None) if masks or not steps else None
    if masks:
        compared = experiment.compare(now.belief, spacing, jacobian=False, gain=now.gain)
        count = mask_outliers(experiment, compared)
        if count:
            if not steps:
                # As it was with them, to show what leaving them out brings.
                before = experiment.compare(now.belief, spacing)
                done(Step(now.belief, now.solution, before, experiment.assess(before), spacing))
            say(f"{count} measurements do not move with their neighbours: left out as {FAULT}")
            experiment.problems.clear()
            now = assimilated(experiment, now.belief, spacing, criteria=criteria, say=say)
            done(step_of(experiment, now, grids, criteria, added=(FAULT,)))
            now = None
    if not steps:
        done(step_of(experiment, now, grids, criteria))
        now = None
    while not steps[-1].explained and len(steps[-1].belief.terms) < criteria.largest_model:
        if names is not None and set(names) <= set(steps[-1].belief.effects):
            break
        now = now or begun(steps[-1])
        if steps[-1].spacing > grids.deciding and is_free(now, criteria):
            # What is near the data on the coarse grid is asked on the one that decides.
            better = step_of(experiment, now, grids, criteria, added=steps[-1].added, ties=steps[-1].ties)
            steps[-1] = replace(better, table=steps[-1].table, warnings=steps[-1].warnings)
            now = None
            continue
        round_ = held_round(
            experiment,
            now,
            spacing,
            fine=grids.deciding,
            seed=(seed, len(steps)),
            names=names,
            criteria=criteria,
            say=say,
        )
        rankings.append(ranking_of(round_.scan, now.belief))
        step = decided(experiment, round_, grids, criteria, say)
        if step is None:
            say("nothing that is known pays for its numbers")
            table = table_of(round_)
            break
        if known_budget(steps[-1]) and excess(step.assessment) > excess(steps[-1].assessment):
            say(f"{', '.join(step.added)}: leaves more than before")
            table = table_of(round_)
            break
        done(step)
        now = None
    if steps[-1].explained and len(steps[-1].belief.terms) > 1:
        steps[-1] = without_superfluous(experiment, steps[-1], criteria, say)
    if steps[-1].explained and steps[-1].added:
        steps[-1] = concluded(experiment, steps[-1])
    return _conclude(steps, rankings, table)


def without_superfluous(
    experiment: Experiment, step: Step, criteria: Criteria, say: Callable[[str], None]
) -> Step:
    """The step less the effects that are superfluous beside the others: without one the misfit hardly rises
    (see `Criteria.negligible_rise`)."""
    for term in step.belief.terms[:-1]:
        problem = experiment.problem(step.spacing)
        try:
            less = minimise(
                problem, step.belief.without_effect(term.name), iterations=DECIDING, relative_tolerance=3e-4
            )
        except SimulationError:
            continue
        rise = less.evaluation.chi_square - step.solution.evaluation.chi_square
        rows = step.solution.evaluation.data_rows
        if rise < criteria.negligible_rise * rows:
            say(f"{term.name} is superfluous beside {', '.join(step.added)}")
            compared = experiment.compare(less.belief, step.spacing, refine=True, beside=step.beside)
            assessment = experiment.assess(compared)
            after = replace(
                step, belief=less.belief, solution=less, compared=compared, assessment=assessment,
                dropped=(*step.dropped, term.name), moved={},
            )  # fmt: skip
            if after.explained:
                step = after
    return step


def concluded(experiment: Experiment, step: Step) -> Step:
    """The step fitted to its last digits."""
    try:
        solution = minimise(
            experiment.problem(step.spacing), step.belief, iterations=CONCLUDING, relative_tolerance=1e-5
        )
        compared = experiment.compare(solution.belief, step.spacing, refine=True, beside=step.beside)
    except SimulationError:
        return step
    after = replace(
        step,
        belief=solution.belief,
        solution=solution,
        compared=compared,
        assessment=experiment.assess(compared),
    )
    return after if after.explained else step


def _conclude(steps: list[Step], rankings: list[Ranking], table: tuple[dict, ...]) -> Discovery:
    """What the steps come to, with what is to be said of the last one."""
    last = steps[-1]
    added: list[str] = []
    for step in steps:
        added += [name for name in step.added if name not in added]
        added = [name for name in added if name not in step.dropped]
    if not last.explained:
        verdict, added = "unknown", []
    elif not added:
        verdict = "adequate"
    else:
        verdict = "missing" if any(effect(n).kind != "measurement" for n in added) else "measurement"
    said = [text for step in steps for text in step.warnings]
    said += [
        f"{term.name}: acts since the first frame; the published shape does not bear it"
        for term in last.belief.terms
        if term.name in added and term.settings.get("at_rest") is False and "sequences" not in term.settings
    ]
    if last.assessment.worst < FAR_LESS:
        worst = last.assessment.worst
        said.append(
            f"no range leaves more than {worst:.2g} of the noise: sigma may be {1.0 / max(worst, 1e-3):.2g} "
            "times too large, and hide what is missing"
        )
    said += doubted_sigma(last.compared)
    rows = table or last.table
    return Discovery(verdict, tuple(added), tuple(steps), tuple(rankings), tuple(said), rows)
