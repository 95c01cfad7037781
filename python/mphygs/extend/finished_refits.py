"""Refits that were begun and are closest, brought to the end."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mphygs.diagnose.grid_error import unabsorbed
from mphygs.diagnose.ranking import RankedEffect
from mphygs.extend.model_selection import ALIKE, ALIKE_EXCESS
from mphygs.extend.refit import AT_FLOOR, Refit, finish_refit
from mphygs.extend.step import Step
from mphygs.extend.window_continuation import BEHIND, FINISHED, Begun
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.schedule import SCREENING_ACCURACY

# Beyond FINISHED of them, those within a factor of the best chi^2 are brought to the end.
NEARLY = 1.25


def finish_closest(
    experiment: Experiment,
    current: Step,
    begun: Sequence[Begun],
    near: bool,
    spacing: float,
    generator: np.random.Generator,
    say: Callable[[str], None],
) -> list[Refit]:
    """The refits that are closest, brought to the end. begun: chi^2, entry and fit, the best first."""
    finished: list[Refit] = []

    def finish(entry: RankedEffect, solution: Solution) -> None:
        result = finish_refit(
            experiment,
            current.solution,
            current.compared,
            entry,
            solution,
            spacing,
            generator=generator,
            accuracy=SCREENING_ACCURACY,
            hopeless=_hopeless(experiment, finished, spacing),
            report=say,
        )
        if result is not None:
            finished.append(result)
            say(
                f"{entry.effect}: {current.assessment.worst:.3f} -> {result.assessment.worst:.3f} sigma "
                "in the worst range"
            )

    for number, (chi_square, entry, solution) in enumerate(begun):
        # What the coarse grid has of its own may put the true effect a little behind.
        # Only one that pays ends the search.
        behind = ALIKE if near and any(r.pays for r in finished) else BEHIND
        if near and number >= FINISHED:
            ends = not _worth_the_end(begun, number, finished)
        else:
            ends = chi_square > (behind if number < FINISHED else NEARLY) * begun[0][0]
        if ends:
            break
        finish(entry, solution)
    return finished


def _at_noise(refit: Refit) -> bool:
    """Whether a refit pays and leaves noise alone."""
    return refit.pays and refit.assessment.worst <= AT_FLOOR


def _worth_the_end(
    begun: Sequence[Begun], number: int, finished: Sequence[Refit]
) -> bool:
    """Whether a further refit is brought to the end near the floor, where all are within a factor of the best
    and what they leave beyond noise tells: as little as the best, or as rivals may; or, as long as none of so
    many again is at the noise, what the true effect may leave after few iterations."""
    rows = begun[number][2].evaluation.data_rows
    beyond, least = begun[number][0] - rows, begun[0][0] - rows
    if beyond <= max(NEARLY * least, ALIKE_EXCESS * rows):
        return True
    return number < 2 * FINISHED and beyond <= BEHIND * least and not any(_at_noise(r) for r in finished)


def _hopeless(experiment: Experiment, finished: Sequence[Refit], spacing: float) -> float:
    """chi^2 of the fitted frames above which no further refit is brought to the end."""
    # What does not pay may have bought the fitted frames: it sets no bound.
    paying = [r for r in finished if r.pays]
    if not paying:
        return np.inf
    best = min(paying, key=lambda r: r.solution.evaluation.chi_square)
    evaluation = best.solution.evaluation
    # Nothing is better than noise, nor told apart within what the grid has of its own.
    own = unabsorbed(experiment, spacing, best.belief, evaluation)
    return ALIKE * max(evaluation.chi_square, evaluation.data_rows * (1.0 + own**2))
