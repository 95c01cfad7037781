"""Where the cause of a misfit is looked for: on a coarser grid that shows the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from mphygs.extend.finer_grid import best_fitting
from mphygs.extend.grids import on_grid
from mphygs.extend.simplest_recordings import compared_on_all, explains
from mphygs.extend.step import Step
from mphygs.fit.experiment import Experiment
from mphygs.simulate.errors import SimulationError

# A misfit that a coarser grid has as well, within this factor, is looked for there.
SAME_MISFIT = 1.3


def on_coarse_grid(
    experiment: Experiment,
    step: Step,
    spacing: float,
    report: Callable[[str], None] | None = None,
    *,
    simple: Sequence[str] = (),
) -> Step:
    """The step to look for its misfit's cause in: on a coarser grid where that shows the same misfit, at a
    fraction of the work, else as it is.

    spacing: of the coarser grid [m]; simple: sequences that a model of all is first to explain. A step that
    explains them is refitted to them alone: what the others have besides is to be seen from there, and a fit
    to all buys it with absurd materials.
    """
    if step.spacing > 0.9 * spacing:
        return step
    if simple and explains(step, simple):
        inner = experiment.only(simple)
        alone = replace(step, belief=inner.starting(step.belief))
        alone = on_grid(inner, alone, spacing, report, tangents=False)
        try:
            coarse = alone and compared_on_all(experiment, step.belief, alone)
        except SimulationError:
            return step
        return coarse if coarse and explains(coarse, simple) else step
    coarse = on_grid(experiment, _as_it_was(experiment, step, spacing), spacing, report, tangents=False)
    if coarse is None or coarse.assessment.worst > SAME_MISFIT * step.assessment.worst:
        return step
    return coarse


def _as_it_was(experiment: Experiment, step: Step, spacing: float) -> Step:
    """The step as it was fitted on a coarser grid, where that is the same model and fits better there."""
    coarse, now = step.coarse_belief, step.belief
    if coarse is None or [p.key for p in coarse.free] != [p.key for p in now.free]:
        return step
    return replace(step, belief=best_fitting(experiment.problem(spacing), (now, coarse)) or now)
