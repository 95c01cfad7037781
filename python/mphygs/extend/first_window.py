"""The first frames of a motion, on which a model that lacks something is still nearly right."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial

import numpy as np

from mphygs.diagnose.grid_error import unabsorbed
from mphygs.extend.step import Step
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.part_scales import on_by_part
from mphygs.fit.problem import Evaluation
from mphygs.fit.schedule import TRACTABLE
from mphygs.fit.stiffness_scale import (
    HARDLY_WORSE,
    about_its_scale,
    at_scales,
    find_scale,
    with_materials_at_prior,
)
from mphygs.model.belief import Belief

# Diagnosis looks at the first frames over which the misfit is between this and TRACTABLE [sigma].
VISIBLE = 1.25
WINDOWS = (0.25, 0.4, 0.55, 0.75)
# Share of the cost that the last step of a fit to a window may promise.
ACCURACY = 1e-3
SHORTER = (0.16, 0.1, 0.06)
# Of common scales at which a gross model is hardly worse than at the best so many are looked from.
OTHERS = 3
# The share of the frames that a first model was fitted to on its way.
HALF = 0.5
ON_THE_WAY = "passed on the way"
# What is left is the grid's own where that may be so many times as much: of thin parts it says too much.
OWN = 2.0
# Of the frames of other recordings, seen from the model that explains the simplest ones.
SEEN = 0.16


def _ratio(evaluation: Evaluation, explained: Sequence[str] = ()) -> float:
    """Root mean square over sigma of the fitted frames, sequences that are explained left out."""
    of = [evaluation.residual[rows] for name, rows in evaluation.rows.items() if name not in explained]
    return float(np.sqrt(sum(r @ r for r in of) / max(sum(len(r) for r in of), 1)))


def _absurd(belief: Belief) -> bool:
    """Whether a material ended at a bound."""
    return any(p.at_bound for p in belief.free if p.log and p.key.rsplit(".", 1)[0] in belief.parts)


def passed_on_the_way(half: Belief | None, before: Iterable[float]) -> Belief | None:
    """The model of the first half of the frames, where a fit had one and nothing showed before: what does is
    to be looked for there. before: misfits [sigma] of the fits to fewer frames."""
    return None if any(misfit > VISIBLE for misfit in before) else half


def at_other_scales(experiment: Experiment, window: tuple[float, Solution], spacing: float) -> list[Solution]:
    """Of a first model that is far off even on the first few frames: these frames seen with all parts as soft
    as usual, at common scales that are hardly worse, the softest first. None where it is not far off.

    What acts from the start on is bought with stiffness, which answers to nothing: an effect is told from
    materials that would.
    """
    share, solution = window
    if share > SHORTER[-1] or solution.belief.terms:
        return []
    if _ratio(solution.evaluation, experiment.whole) < TRACTABLE:
        return []
    problem, belief = experiment.window(spacing, share), with_materials_at_prior(solution.belief)
    seen = [(cost, trial) for _, cost, trial in at_scales(problem, belief, near=HARDLY_WORSE)]
    least = min((cost for cost, _ in seen), default=np.inf)
    softest = [trial for cost, trial in reversed(seen) if cost <= HARDLY_WORSE * least][:OTHERS]
    chosen = [about_its_scale(trial) for trial in softest]
    evaluations = [problem.evaluate(trial) for trial in chosen]
    return [
        Solution(trial, evaluation, (evaluation.cost,), True, "at another scale")
        for trial, evaluation in zip(chosen, evaluations, strict=True)
    ]


def tractable_window(
    experiment: Experiment, current: Step, spacing: float, say: Callable[[str], None]
) -> tuple[float, Solution]:
    """The share of the fitted frames to diagnose on, and the model fitted to them.

    A model that lacks a strong effect buys the whole motion with absurd materials (one at a bound says that
    it did), and no tangent there says anything. Over its first frames the same model is nearly right: the
    window ends where the misfit is clearly more than noise, and may not well be the grid's own, but still
    small.
    """
    evaluation = current.solution.evaluation

    def ratio_of(evaluation: Evaluation) -> float:
        return _ratio(evaluation, experiment.whole)

    limit = VISIBLE if not current.added and _absurd(current.belief) else TRACTABLE
    if ratio_of(evaluation) < limit:
        return 1.0, current.solution
    belief = current.belief
    if experiment.whole:
        # What the other recordings have besides is seen from the model that explains the simplest.
        evaluation = experiment.window(spacing, SEEN).evaluate(belief)
        say(f"seen from {', '.join(experiment.whole)}: {ratio_of(evaluation):.3f} sigma")
        if ratio_of(evaluation) > VISIBLE:
            return SEEN, Solution(belief, evaluation, (evaluation.cost,), True, "seen from the simplest")
    best: tuple[float, Solution] | None = None

    def grids_own(share: float, solution: Solution) -> bool:
        """Whether all that is left there may well be the grid's own."""
        beyond = np.sqrt(max(ratio_of(solution.evaluation) ** 2 - 1.0, 0.0))
        own = unabsorbed(experiment, spacing, solution.belief, solution.evaluation, share=share)
        say(f"  beyond noise {beyond:.3g} sigma; the grid may have {own:.3g} of its own")
        return own > OWN * beyond

    if current.halfway is not None:
        # The fit passed a window on its way.
        evaluation = experiment.window(spacing, HALF).evaluate(current.halfway)
        say(f"window of {HALF:.0%} of the frames: {ratio_of(evaluation):.3f} sigma")
        passed = Solution(current.halfway, evaluation, (evaluation.cost,), True, ON_THE_WAY)
        if ratio_of(evaluation) < TRACTABLE:
            if ratio_of(evaluation) > VISIBLE and not grids_own(HALF, passed):
                return HALF, passed
            best, belief = (HALF, passed), current.halfway
    if not current.added and best is None:
        belief = find_scale(experiment.window(spacing, WINDOWS[0]), with_materials_at_prior(belief))

    def fitted(share: float, start: Belief, *, anew: bool = False) -> Solution:
        problem = experiment.window(spacing, share)
        again = partial(minimise, problem, iterations=8, relative_tolerance=ACCURACY, gross=TRACTABLE)
        solution = again(start)
        if anew:
            solution = on_by_part(problem, solution, again, accuracy=ACCURACY, say=say)
        say(f"window of {share:.0%} of the frames: {ratio_of(solution.evaluation):.3f} sigma")
        return solution

    def seen_from(fit: Solution, share: float, farther: float) -> tuple[float, Solution]:
        """Something sets in between, a contact say. The model of the frames before it is right there: what
        it lacks is seen from it on the frames after."""
        before = fit.belief
        evaluation = experiment.window(spacing, share).evaluate(before)
        say(f"seen from before, {share:.0%} of the frames: {ratio_of(evaluation):.3f} sigma")
        if ratio_of(evaluation) < VISIBLE * max(1.0, ratio_of(fit.evaluation)):
            share = farther
            evaluation = experiment.window(spacing, share).evaluate(before)
        return share, Solution(before, evaluation, (evaluation.cost,), True, "seen from before")

    shares = [share for share in WINDOWS if best is None or share > HALF]
    if best is None:
        shortest, beyond = fitted(WINDOWS[0], belief, anew=not current.added), WINDOWS[0]
        for share in SHORTER:
            if ratio_of(shortest.evaluation) < TRACTABLE:
                break
            # Even that is far off: several swings, or a load that nothing in the model answers to.
            beyond = WINDOWS[0] if best is None else best[0]
            shortest = fitted(share, belief)
            best = (share, shortest)
        if best is not None:
            if ratio_of(shortest.evaluation) < VISIBLE:
                return seen_from(shortest, 0.5 * (best[0] + beyond), beyond)
            return best
    for share in shares:
        solution = shortest if share == WINDOWS[0] else fitted(share, belief)
        ratio = ratio_of(solution.evaluation)
        if best is not None and ratio > TRACTABLE:
            return seen_from(best[1], 0.5 * (best[0] + share), WINDOWS[-1])
        best, belief = (share, solution), solution.belief
        if ratio > VISIBLE and not grids_own(share, solution):
            break
    if ratio_of(best[1].evaluation) < VISIBLE:
        # It sets in later still.
        evaluation = experiment.problem(spacing).evaluate(belief)
        say(f"seen from before, all frames: {ratio_of(evaluation):.3f} sigma")
        return 1.0, Solution(belief, evaluation, (evaluation.cost,), True, "seen from before")
    return best
