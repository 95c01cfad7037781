"""What sets in at some moment, brought from a coarse grid to a finer one, or from before it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from mphygs.compare.assess import BUDGET_FLOOR
from mphygs.diagnose.wall import hold_friction, release_friction
from mphygs.extend.finer_grid import jacobian_source
from mphygs.extend.onset_fit import fit_onset_then_all, with_onset_fitted
from mphygs.fit.borrowed_jacobians import approached
from mphygs.fit.experiment import Experiment
from mphygs.fit.part_scales import on_by_part
from mphygs.fit.problem import Problem
from mphygs.fit.stiffness_scale import find_scale, with_materials_at_prior
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

# The frames before something sets in, over those in which it was first seen.
BEFORE = 0.85
# Iterations of a refit on some of the frames, and the share of the cost that the last may promise.
ITERATIONS, ACCURACY = 8, 3e-3


def growing_shares(share: float, kind: str) -> list[float]:
    """Shares of the frames on the way from a window to all of them; what sets in at some moment (a threshold)
    is followed in smaller steps."""
    shares = []
    while share < 1.0:
        share = min(2.0 * share, 0.5 * (1.0 + share)) if kind == "threshold" else 2.0 * share
        shares.append(1.0 if share > 0.8 else share)
        share = shares[-1]
    return shares


def onset_on_grid(
    experiment: Experiment,
    belief: Belief,
    window_share: float,
    jacobian_problem: Problem | None,
    spacing: float,
    tell: Callable[[int, object, object], None] | None = None,
) -> Belief:
    """The belief with what sets in, from what a coarser grid made of it where that fits here as well, else
    from before it (see `onset_refitted`), whichever fits better."""
    problem, direct = experiment.problem(spacing), None
    if jacobian_problem is not None:
        try:
            direct = approached(
                problem,
                jacobian_problem,
                with_onset_fitted(problem, belief, jacobian_problem=jacobian_problem),
                report=tell,
            )
            reached = problem.evaluate(direct, jacobian=False)
            if reached.misfit <= BUDGET_FLOOR:
                return direct
        except SimulationError:
            direct = None
    anew = onset_refitted(experiment, belief, window_share, spacing, tell)
    if direct is None:
        return anew
    try:
        anew = approached(problem, jacobian_problem, anew, report=tell)
        better = problem.evaluate(anew, jacobian=False).cost < reached.cost
    except SimulationError:
        better = False
    return anew if better else direct


def onset_refitted(
    experiment: Experiment,
    belief: Belief,
    window_share: float,
    spacing: float,
    tell: Callable[[int, object, object], None] | None = None,
) -> Belief:
    """The belief with what sets in at a share `window_share` of the frames, refitted from before that moment
    onward.

    The materials begin anew from the frames before: those found without the effect are those that bent the
    motion most, and what an impact sets swinging, seen thirty times a second, has many such minima.
    """

    def window(share: float, start: Belief, iterations: int, *, far: bool = False) -> Belief:
        problem = experiment.window(spacing, share)
        # Far from the minimum a step of the coarse grid may lead to where that grid carries nothing.
        jacobian_problem = None if far else jacobian_source(experiment, spacing, share)
        again = partial(
            fit_onset_then_all,
            problem,
            iterations=iterations,
            jacobian_problem=jacobian_problem,
            accuracy=ACCURACY,
            report=tell,
        )
        found = again(start)
        return (on_by_part(problem, found, again, accuracy=ACCURACY) if far else found).belief

    belief = hold_friction(belief)
    before = [BEFORE * share * window_share for share in (0.5, 1.0)]
    try:
        # There nothing has set in, and what will is left out: it could only be in the way.
        anew = with_materials_at_prior(belief)
        for name in belief.effects:
            if effect(name).kind == "threshold":
                anew = anew.without_effect(name)
        anew = find_scale(experiment.window(spacing, before[0]), anew)
        for share in before:
            anew = window(share, anew, ITERATIONS, far=True)
        found = {p.key: p for p in anew.parameters}
        parameters = tuple(p.found(found.get(p.key, p)) for p in belief.parameters)
        belief = replace(belief, parameters=parameters)
    except SimulationError:
        pass  # from what the coarser grid had
    belief = release_friction(window(window_share, belief, ITERATIONS // 2))
    for share in [window_share, *growing_shares(window_share, "threshold")][1:-1]:
        belief = window(share, belief, ITERATIONS // 2)
    return belief
