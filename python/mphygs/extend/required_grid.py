"""The grid that a step's misfit asks for, with the error budget where that decides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from mphygs.compare.assess import LARGEST_EXCUSED, LARGEST_GRID_ERROR
from mphygs.diagnose.grid_error import may_have_all
from mphygs.extend.finer_grid import on_finer_grid
from mphygs.extend.grids import (
    BEYOND,
    CLEAR,
    EXPLAINED_ON_COARSE,
    GROSS,
    complete,
    far_beyond,
    has_onset,
    on_grid,
    report_budget,
    with_budget,
)
from mphygs.extend.simplest_recordings import sequences_without_loads
from mphygs.extend.step import LARGELY, Step, excess, known_budget, leaves_most, staying
from mphygs.fit.experiment import Experiment
from mphygs.fit.spacings import deciding_spacing, screening_spacing


def next_spacing(
    experiment: Experiment, steps: Sequence[Step], report: Callable[[str], None] | None = None
) -> float | None:
    """Spacing [m] on which the last step should be asked again, None where its grid will do."""
    first, last = steps[0], steps[-1]
    deciding = deciding_spacing(experiment.capture)
    if last.spacing < 1.1 * deciding:
        return None
    if leaves_most(steps) and not has_onset(last) and not sequences_without_loads(experiment):
        # No third effect is tried: what a finer grid may have of it decides.
        undecided = not misses_physics(steps[-2]) and _grid_may_have(experiment, last, report)
        return deciding if undecided else None
    # What sets in is judged by the fitted frames: how it goes on from there they may leave open.
    label = "fit" if has_onset(last) else None
    small = last.added and excess(last.assessment, label) < EXPLAINED_ON_COARSE * excess(
        first.assessment, label
    )
    if small or last.assessment.worst < GROSS:
        return deciding
    if not last.added and last.solution.evaluation.misfit < GROSS:
        # Near enough on the fitted frames, and far off on others: the grid's error bends the materials.
        return deciding if _grid_may_have(experiment, last, report) else None
    fell = last.added and excess(last.assessment, label) < LARGELY * excess(steps[-2].assessment, label)
    return deciding if fell and _grid_may_have(experiment, last, report) else None


def misses_physics(step: Step) -> bool:
    """Whether a step's budget, where it is known, says that what it leaves is not the grid's."""
    budget = step.assessment.budget
    return known_budget(step) and budget["physics"] > BEYOND * budget["discretisation"]


def _grid_may_have(experiment: Experiment, step: Step, report: Callable[[str], None] | None) -> bool:
    if report:
        report(f"what a grid finer than {1e3 * step.spacing:.3g} mm changes")
    return may_have_all(experiment, step.spacing, step.belief, step.solution.evaluation)


def on_required_grid(
    experiment: Experiment,
    steps: Sequence[Step],
    report: Callable[[str], None] | None,
    *,
    screening: bool,
    tied: bool = False,
) -> Step:
    """The last step on the grid that its misfit asks for, with its error budget where that decides.

    screening: whether the grid so far was only for trying many models, and another may be chosen; tied:
    whether others do alike, which the deciding grid tells: kinds of damping, say, differ by less than the
    error of a coarse one.
    """
    current, hopeless, spacing = steps[-1], False, None
    if screening and not known_budget(current) and current.assessment.worst > LARGEST_EXCUSED:
        # No tangents will excuse it: another grid may be asked without them.
        spacing = next_spacing(experiment, steps, report)
    if spacing is None:
        current = complete(experiment, current, screening=screening)
        spacing = next_spacing(experiment, steps, report) if screening and not current.explained else None
    deciding = deciding_spacing(experiment.capture)
    if screening and tied and current.explained and current.spacing > 1.1 * deciding:
        spacing = deciding
    if spacing is not None:
        moved = on_grid(experiment, current, spacing, report)
        hopeless = moved is not None and far_beyond(
            current.assessment.worst, moved.assessment.worst, current.spacing / moved.spacing
        )
        current = moved or complete(experiment, current, screening=screening)
    fine = not screening or current.spacing < 1.1 * deciding_spacing(experiment.capture)
    if not fine or current.explained or current.assessment.worst >= LARGEST_GRID_ERROR:
        return current
    if screening and current.assessment.worst > CLEAR:
        # What a coarser grid shows of it, at a tenth of the work, may say that it is far too little.
        rough = with_budget(experiment, current, refinement_spacing=screening_spacing(experiment.capture))
        if misses_physics(rough):
            report_budget(rough, report)
            return rough
    small = excess(current.assessment) < EXPLAINED_ON_COARSE * excess(steps[0].assessment)
    if screening and current.added and small and not has_onset(current) and not hopeless:
        after = on_finer_grid(experiment, current, report)
        if after is not None and after.explained:
            return after
        if after is not None and after.stays:
            current = replace(current, compared=staying(current.compared))
    return with_budget(experiment, current, report)
