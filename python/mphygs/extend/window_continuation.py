"""Refits to the first frames, followed onward to all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mphygs.diagnose.ranking import RankedEffect
from mphygs.extend.model_selection import ALIKE
from mphygs.extend.onset_fit import fit_onset_then_all
from mphygs.extend.onset_transfer import growing_shares
from mphygs.extend.relocation import AT_NOISE, relocated_anywhere
from mphygs.fit.countdown import Countdown
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.place_fit import movable, relocated
from mphygs.fit.side_by_side import side_by_side, waves
from mphygs.simulate.errors import SimulationError

# A refit that was begun: chi^2, what it adds, the fit.
Begun = tuple[float, RankedEffect, Solution]

# Of so many all are followed, whatever they leave.
FINISHED = 3
# Below this misfit [sigma] what is linear in the parameters says most.
LINEAR = 2.0
# One that leaves so many times the best one's chi^2 once it was followed onward is not brought to the end;
# one whose place is not fitted yet may leave more.
BEHIND, MISPLACED = 3.0, 6.0
# On the way a place is fitted again where it leaves more than noise and less than so much [sigma], as a wrong
# effect does.
MISLED = 1.5
# What leaves less than so much there, on a coarse grid, is not misled.
SETTLED = 1.05


def with_places_fitted(
    experiment: Experiment,
    begun: Sequence[Begun],
    share: float,
    spacing: float,
    say: Callable[[str], None],
    *,
    anywhere: bool = True,
) -> list[Begun]:
    """The refits, those that are not far behind with their places fitted: proposed from a few, a place is
    half a cell from its own or more. anywhere: also from places around and all over the object: where other
    materials proposed it, it may be far from its own."""
    fitted = relocated_anywhere if anywhere else relocated
    best = min((chi_square for chi_square, _, _ in begun), default=np.inf)

    def relocate(twin: Experiment, item: Begun) -> Begun:
        chi_square, entry, fit = item
        if chi_square > MISPLACED * best or not movable(fit.belief):
            return item
        try:
            fit = fitted(twin.window(spacing, share), fit, report=say)
        except SimulationError:
            return item
        return fit.evaluation.chi_square, entry, fit

    return side_by_side(experiment, relocate, begun)


def _frames_ahead(followed: Sequence[tuple[RankedEffect, Solution, list[float]]], share: float) -> float:
    """Shares of the frames that refits have to be fitted to yet, beyond a share, all together."""
    return sum(reach for _, _, plan in followed for reach in plan if reach > share)


def continued_to_all_frames(
    experiment: Experiment,
    share: float,
    begun: Sequence[Begun],
    spacing: float,
    say: Callable[[str], None],
) -> list[Begun]:
    """Refits to a share of the frames brought to all of them, side by side. begun: chi^2, entry and fit, the
    best first, as they are returned.

    The motion is followed from the window on, not met all at once: half a swing off there is no way back. Who
    falls behind others on the way is not brought to the end.
    """
    followed = [(entry, solution, growing_shares(share, entry.kind)) for _, entry, solution in begun]
    # A fit to twice the frames takes about twice as long.
    countdown = Countdown(say, "followed onward", _frames_ahead(followed, share))
    for reach in sorted({reach for _, _, plan in followed for reach in plan}):
        passing = [item for item in followed if reach not in item[2]]
        there: list[tuple[RankedEffect, Solution, list[float]]] = []
        for wave in waves([item for item in followed if reach in item[2]]):
            best = min((fit.evaluation.chi_square for _, fit, _ in there), default=np.inf)
            # Behind on the way is not behind in the end.
            hopeless = BEHIND * best if reach == 1.0 else np.inf
            # Where another one is at noise, as far as a grid tells, no place makes up for an effect that is
            # not.
            settled = any(fit.evaluation.misfit < SETTLED for _, fit, _ in there)

            def follow(
                twin: Experiment,
                item: tuple[RankedEffect, Solution, list[float]],
                reach: float = reach,
                hopeless: float = hopeless,
                settled: bool = settled,
            ) -> Solution | None:
                problem = twin.window(spacing, reach)
                try:
                    fit = fit_onset_then_all(problem, item[1].belief, hopeless=hopeless)
                    # More frames tell more of where it sits.
                    off = AT_NOISE < fit.evaluation.misfit < MISLED
                    if off and not settled and reach < 1.0 and movable(fit.belief):
                        fit = relocated_anywhere(problem, fit, report=say)
                except SimulationError:
                    return None
                return fit

            for (entry, _, plan), fit in zip(wave, side_by_side(experiment, follow, wave), strict=True):
                if fit is None:
                    continue
                say(f"with {entry.effect}, {reach:.0%} of the frames: {fit.evaluation.misfit:.3f} sigma")
                if fit.evaluation.chi_square <= hopeless:
                    there.append((entry, fit, plan))
        there.sort(key=lambda item: item[1].evaluation.chi_square)
        if reach < 1.0:
            there = [
                item
                for number, item in enumerate(there)
                if number < FINISHED
                or item[1].evaluation.chi_square < ALIKE * there[0][1].evaluation.chi_square
            ]
        done = reach * sum(reach in plan for _, _, plan in followed)
        followed = passing + there
        countdown.done(done, left=_frames_ahead(followed, reach))
    reached = [(solution.evaluation.chi_square, entry, solution) for entry, solution, _ in followed]
    return sorted(reached, key=lambda item: item[0])
