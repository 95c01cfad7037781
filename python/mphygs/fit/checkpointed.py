"""A fit that can be stopped after any stage and continued to the same numbers, bit for bit."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from mphygs.fit.determined import information_of
from mphygs.fit.experiment import REFINEMENT, Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.paper_plan import PaperStage, paper_plan, remembers
from mphygs.fit.run import Run, StageRecord
from mphygs.fit.schedule import ScheduleStage, fit_belief, plan_of
from mphygs.fit.uncertainty import coordinate_covariance, grid_change, prediction_change
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError


def _forget(experiment: Experiment) -> None:
    """Drop what rest shapes remember of their last solution: the next stage begins as after a resume."""
    for problem in experiment.problems.values():
        for predictor in problem.predictors.values():
            predictor.forget()


def _ratio(plan: Sequence[ScheduleStage | PaperStage], number: int) -> float:
    """How much coarser the grid of the stage before was, which fitted the same frames; 1 where it tells
    nothing of the grid."""
    stage, before = plan[number], plan[number - 1] if number else None
    if (
        not isinstance(before, ScheduleStage)
        or not isinstance(stage, ScheduleStage)
        or before.share != stage.share
    ):
        return 1.0
    return before.spacing / stage.spacing


def _spread(
    experiment: Experiment, solution: Solution, before: Belief, spacing: float, coarser: float, alone: bool
) -> np.ndarray:
    """(P, P) covariance of a fit. before: the belief of the stage before; coarser: see `_ratio`; alone:
    whether a finer grid is asked for the error of this one, where there was no coarser one."""
    problem, evaluation = experiment.problem(spacing), solution.evaluation
    ratio = coarser if coarser > 1.0 else 1.0 / REFINEMENT
    change = None
    if coarser > 1.0 or alone:
        try:
            other = experiment.problem(spacing * ratio).evaluate(solution.belief, jacobian=False)
        except SimulationError:
            pass  # what the other grid cannot carry it cannot be compared with
        else:
            change = prediction_change(evaluation, other, ratio)
    moved = grid_change(before, solution.belief, coarser) if coarser > 1.0 else None
    return coordinate_covariance(problem, evaluation, moved, change)


def fit_run(
    run: Run,
    experiment: Experiment,
    *,
    optimiser: str = "gauss-newton",
    schedule: str = "fast",
    warm: bool = False,
    windows: bool = True,
    screening: bool = False,
    progress: Callable[[float, str], None] | None = None,
) -> Run:
    """Run the stages that a run has not had yet; the folder is written after each of them.

    optimiser: gauss-newton, adam or lbfgs, of the schedule "fast"; schedule: that, or "paper", which takes
    Adam; warm: the run's belief is near its minimum already (fast only); windows: False fits all frames
    at once from the start, as an ablation; screening: see `plan_of`; progress: told the share of the work
    done, and a line.
    Raises SimulationError where the fit cannot start.
    """
    if run.complete:
        return run
    paper = schedule == "paper"
    newton = not paper and optimiser == "gauss-newton"
    spacing = run.settings.spacing
    plan: Sequence[ScheduleStage | PaperStage] = (
        paper_plan(spacing, experiment.fitted, from_rest=remembers(run.belief.effects))
        if paper
        else plan_of(experiment.capture, spacing, warm=warm, screening=screening, searching=newton)
    )
    if not windows:
        plan = tuple(s for s in plan if (s.length is None if isinstance(s, PaperStage) else s.share == 1.0))
    total = sum(stage.work for stage in plan)
    done = sum(stage.work for stage in plan[: len(run.history)])
    begin = time.monotonic()
    steps = 0.0
    experiment.problem(run.settings.spacing)  # the noise is learnt once, and before anything is fitted

    def report(line: str, step: float = 1.0) -> None:
        nonlocal steps
        steps += step
        if progress:
            stage = plan[min(len(run.history), len(plan) - 1)]
            share = min(steps / (stage.reports + 1), 0.95)
            progress((done + share * stage.work) / total, line)

    def aside(line: str) -> None:
        stage, before = plan[len(run.history)], plan[len(run.history) - 1]
        report(line, (stage.spacing / before.spacing) ** 4)

    def after_stage(stage: ScheduleStage | PaperStage, solution: Solution) -> None:
        nonlocal run, done, begin, steps
        now = time.monotonic()
        record = StageRecord(
            stage.name,
            stage.spacing,
            tuple(solution.history),
            solution.converged,
            solution.reason,
            now - begin,
            float(solution.evaluation.misfit),
        )
        last = len(run.history) + 1 == len(plan)
        before, coarser = solution.start or run.belief, _ratio(plan, len(run.history))
        run = replace(run, belief=before)
        run = run.after(record, solution.belief)
        if last:
            run = replace(
                run,
                covariance=_spread(
                    experiment, solution, before, stage.spacing, coarser, not (paper or screening)
                ),
                information=information_of(solution.evaluation, len(solution.belief.free)),
            )
        run.save()
        experiment.refer(run.belief)
        _forget(experiment)
        done, begin, steps = done + stage.work, now, 0.0

    _forget(experiment)
    minimiser: Callable[..., object] = fit_belief
    if paper:
        from mphygs.fit.paper import fit_by_windows

        minimiser = fit_by_windows
    elif not newton:
        # torch takes seconds to import, and Gauss-Newton does without it.
        from mphygs.fit.gradient_fit import fit_by_gradient

        minimiser = partial(fit_by_gradient, method=optimiser)
    minimiser(
        experiment.capture,
        run.belief,
        experiment.fitted,
        experiment.observations,
        run.settings,
        **({} if paper else {"warm": warm}),
        **({"aside": aside} if newton else {}),
        **({"before": (run.earlier, run.history[-1].misfit)} if newton and run.history else {}),
        report=report,
        after_stage=after_stage,
        start_stage=len(run.history),
        problems=experiment.problems,
        plan=tuple(plan),
    )
    return run
