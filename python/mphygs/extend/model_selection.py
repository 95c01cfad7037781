"""Which of the refitted models is kept: the best, on the grid that decides, and what ties with it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from mphygs.extend.finer_grid import (
    best_fitting,
    corrected_coarse_problem,
    fitted_by_coarse_jacobians,
    rival_on_coarse_grid,
)
from mphygs.extend.grids import GROSS, complete, on_grid
from mphygs.extend.refit import AT_FLOOR, Refit
from mphygs.extend.required_grid import on_required_grid
from mphygs.extend.step import EXPLAINED, Step, does_alike, excess, excess_on_its_grid
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Problem
from mphygs.fit.side_by_side import side_by_side
from mphygs.model.belief import Parameter

# Effects whose excess is within this factor of the best one's, or below the second number, are its rivals, so
# many at most.
RIVAL, ALIKE_EXCESS, RIVALS = 2.0, 0.1, 4
# So many sigma a coarse grid may leave of a model that is right: up to it the deciding one is asked.
MAY_BE_THE_GRIDS = 1.2
# Refits within this factor of the best chi^2 may still be the best one: on more frames, on a finer grid.
ALIKE = 1.35


def best_and_rivals(refits: Sequence[Refit]) -> tuple[Refit, list[Refit]]:
    """The refit that explains most on all frames, and its rivals: those that explain nearly as much, or all
    but what a coarse grid may have of its own."""
    ordered = sorted(refits, key=lambda r: excess(r.assessment))
    best = ordered[0]
    limit = max(RIVAL * excess(best.assessment), ALIKE_EXCESS)
    if best.assessment.worst <= AT_FLOOR:
        grids = EXPLAINED  # at the noise: the grid has nothing of its own
    elif best.assessment.worst <= EXPLAINED:
        grids = MAY_BE_THE_GRIDS
    else:
        # None does yet, and a wrong model may make up for a coarse grid what the right one leaves to it: each
        # is asked that would be by itself (see `next_spacing`).
        grids = GROSS
    near = [r for r in ordered[1:] if excess(r.assessment) < limit or r.assessment.worst <= grids]
    return best, near[:RIVALS]


def step_of(refit: Refit, spacing: float, refits: Sequence[Refit], window_share: float) -> Step:
    """The model of a refit as a step. window_share: see `Step`."""
    added = (refit.entry.effect,)
    return Step(
        refit.belief, refit.solution, refit.compared, refit.assessment, spacing, added,
        refits=tuple(refits), window_share=window_share,
    )  # fmt: skip


def fewest_parameters(best: Step, rivals: Sequence[Step]) -> tuple[Step, list[Step]]:
    """Of those that do as well as the best the one with fewest parameters, and the rest."""
    same = [best, *(r for r in rivals if r.spacing == best.spacing and does_alike(r, best))]
    chosen = min(same, key=_order)
    return chosen, [step for step in (best, *rivals) if step is not chosen]


def on_the_grid_of(
    experiment: Experiment, best: Step, rival: Step, report: Callable[[str], None] | None
) -> Step | None:
    """A rival on the grid of the best step, None where it is hopeless or cannot be simulated there."""
    if rival.spacing == best.spacing:
        return rival
    hopeless = ALIKE**0.5 * best.solution.evaluation.misfit
    if best.jacobian_spacing is None:
        return on_grid(experiment, rival, best.spacing, report, hopeless=hopeless, tangents=False)
    problem = corrected_coarse_problem(experiment, best)
    nearest = _nearest(problem, rival, best)
    moved = nearest and rival_on_coarse_grid(experiment, problem, nearest, best, report)
    if moved is None or not _may_lead(moved, best):
        return moved
    return fitted_by_coarse_jacobians(experiment, moved, best.spacing, best.jacobian_spacing, report)


def _may_lead(rival: Step, best: Step) -> bool:
    """Whether a rival could take the best step's place."""
    if not does_alike(best, rival):
        return not _takes_the_grids(best, rival)
    return does_alike(rival, best) and _order(rival) < _order(best)


def _order(step: Step, left: Callable[[Step], float] = excess_on_its_grid) -> tuple[int, float]:
    """Of models that do alike the one with fewest parameters comes first, then the one that explains most.
    left: the excess of a step."""
    return step.belief.numbers, left(step)


def _nearest(problem: Problem, rival: Step, best: Step) -> Step | None:
    """The rival with its own materials or with those that the best step found on its finer grid, whichever
    fit better; None where neither can be simulated."""
    found = {p.key: p for p in best.belief.parameters}

    def shared(p: Parameter) -> bool:
        return p.free and p.key in found and p.key.split(".")[0] not in rival.added

    parameters = tuple(p.found(found[p.key]) if shared(p) else p for p in rival.belief.parameters)
    nearest = best_fitting(problem, (rival.belief, replace(rival.belief, parameters=parameters)))
    return nearest and replace(rival, belief=nearest)


def _takes_the_grids(best: Step, rival: Step) -> bool:
    """Whether what a rival explains beyond an explained model is the grid's, which is no gain: it is not
    explained, or not at the floor either and has more parameters for what the best one is excused."""
    if not best.explained:
        return False
    more = rival.belief.numbers > best.belief.numbers
    excused = min(best.assessment.worst, rival.assessment.worst) > EXPLAINED
    return not rival.explained or (excused and more)


def _comparable(steps: Sequence[Step]) -> Callable[[Step], float]:
    """The excess by which steps on one grid are held against each other."""
    if any(step.explained or step.excess_beyond is None for step in steps):
        return excess_on_its_grid
    return lambda step: step.excess_beyond


def selected_model(
    experiment: Experiment,
    steps: Sequence[Step],
    best: Step,
    rivals: Sequence[Step],
    report: Callable[[str], None] | None,
    *,
    screening: bool,
) -> Step:
    """The better of the best step and its rivals on the grid that the best one asks for, with its ties.

    What reaches the floor as well cannot be told from it. A rival that takes its place without explaining the
    motion there is asked for the grid that it wants itself.
    """
    tried = best.refits
    best, rivals = fewest_parameters(best, rivals)
    tied = any(does_alike(r, best) or r.assessment.worst <= MAY_BE_THE_GRIDS for r in rivals)
    best = on_required_grid(experiment, [*steps, best], report, screening=screening, tied=tied)
    if not best.explained:
        best = replace(best, ties=())
    chosen = best_of_rivals(experiment, best, rivals, report, screening=screening)
    if chosen.added != best.added and not chosen.explained:
        tied = bool(chosen.ties)
        chosen = on_required_grid(experiment, [*steps, chosen], report, screening=screening, tied=tied)
    return replace(chosen, refits=tried)


def best_of_rivals(
    experiment: Experiment,
    best: Step,
    rivals: Sequence[Step],
    report: Callable[[str], None] | None,
    *,
    screening: bool = False,
) -> Step:
    """The better of a step and its rivals on the step's grid, with those that do alike as its ties.

    Where none explains the motion there, by what they would leave on an ever finer one: on a grid that is too
    coarse for all of them those lead that happen to make up for it. screening: see `complete`.
    """
    alike = [rival for rival in rivals if rival.spacing == best.spacing]
    # Where the best is not explained on its finer grid, those that may be are asked there as well.
    able = [rival for rival in rivals if best.explained or rival.assessment.worst < GROSS]
    others = [rival for rival in able if rival.spacing != best.spacing]
    moved = side_by_side(experiment, lambda twin, rival: on_the_grid_of(twin, best, rival, report), others)
    alike += [rival for rival in moved if rival is not None]
    left = _comparable([best, *alike])
    alike.sort(key=left)
    beaten = alike and not does_alike(best, alike[0], left=left)
    if beaten and not _takes_the_grids(best, alike[0]):
        best, alike = alike[0], [best, *alike[1:]]
    tied = [best, *(r for r in alike if does_alike(r, best, left=left))]
    tied.sort(key=lambda step: _order(step, left))
    named = dict.fromkeys((*(r.added[0] for r in tied[1:]), *(name for r in tied for name in r.ties)))
    chosen = replace(tied[0], ties=tuple(name for name in named if name not in tied[0].added))
    return complete(experiment, chosen, screening=screening)
