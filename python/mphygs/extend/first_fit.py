"""The first model of a loop fitted and compared, with what it had come to on its way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from mphygs.extend.finer_grid import compared_on_grid
from mphygs.extend.first_window import HALF, passed_on_the_way
from mphygs.extend.step import Step
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.schedule import ScheduleStage, fit_belief, plan_of
from mphygs.model.belief import Belief


def first_fit(
    experiment: Experiment,
    belief: Belief,
    spacing: float,
    *,
    report: Callable[[str], None] | None = None,
    warm: bool = False,
) -> Step:
    """Fit a model and compare it."""
    for name in experiment.fitted:
        experiment.predictor(name, spacing)
    plan = plan_of(experiment.capture, spacing, warm=warm, screening=True)
    passed: dict[float, Solution] = {}

    def after_stage(stage: ScheduleStage, solution: Solution) -> None:
        if stage.spacing == spacing:
            passed[stage.share] = solution

    solution, _ = fit_belief(
        experiment.capture,
        experiment.starting(belief),
        experiment.fitted,
        experiment.observations,
        replace(experiment.settings, spacing=spacing),
        report=report,
        problems=experiment.problems,
        warm=warm,
        plan=plan,
        after_stage=after_stage,
    )
    compared = compared_on_grid(experiment, solution.belief, spacing)
    step = Step(solution.belief, solution, compared, experiment.assess(compared), spacing)
    before = [fit.evaluation.misfit for share, fit in passed.items() if share < HALF]
    half = passed[HALF].belief if HALF in passed else None
    return replace(step, halfway=passed_on_the_way(half, before))
