"""Refits of what a ranking promises: many are begun, few are brought to the end."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mphygs.compare.assess import BUDGET_FLOOR
from mphygs.diagnose.ranking import RankedEffect, Ranking
from mphygs.extend.finished_refits import finish_closest
from mphygs.extend.material_restarts import restarted_from_best_materials
from mphygs.extend.model_selection import ALIKE
from mphygs.extend.refit import Refit
from mphygs.extend.refit_beginning import start_refit
from mphygs.extend.step import Step
from mphygs.extend.window_continuation import (
    FINISHED,
    LINEAR,
    Begun,
    continued_to_all_frames,
    with_places_fitted,
)
from mphygs.fit.countdown import Countdown
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.side_by_side import side_by_side, waves

# So many effects are begun to be refitted.
BEGUN = 8
# Jacobians of a refit that is begun; where all frames are nearly right; from materials that were not fitted.
# Far from the data damping goes to its strength in stages, and the right one may be the last to get there.
FIRST, FIRST_NEAR, FIRST_AFAR = 3, 2, 8
# The share of the cost that the last of these may promise. Far off more of what is promised comes later.
ACCURACY, ACCURACY_AFAR = 1e-3, 1e-4
# An effect predicted to explain less than this share of what the best would is not begun.
WORTH_A_TRY = 0.1
SIGNIFICANT, LEAST_DROP = 1e-3, 16.0
# Below LINEAR [sigma] an effect is tried only where it is predicted to take a share of the excess, less
# where trials of a few sizes predict it, and, short of this share of what the best takes, more than effects
# that do nothing; so many of the best where none takes its share.
NEAR_BEST, LAST_RESORT = 0.2, 2
WORTH_A_REFIT = {"smooth": 0.15, "measurement": 0.15, "threshold": 0.03}
# Up to so many sigma an effect may bring so many times what its tangents promise, fewer times where the best
# one is at the noise; one that would not come near the best one even then is not begun, unless an effect was
# seen to bring more: tangents are no measure then. What sets in has no tangents.
TELLING, BEYOND_TANGENTS, BEYOND_NOISE = 4.0, 3.0, 2.0
# An effect that leaves so many times the best one's chi^2 after an iteration that brings little is not
# followed.
HOPELESS = 10.0
BEHIND = "would stay behind, many times its promise or not"


def significant(ranking: Ranking) -> list[RankedEffect]:
    """Entries that are told from noise, the best first."""
    return [e for e in ranking.entries if e.p_value < SIGNIFICANT and e.statistic > LEAST_DROP]


def promising(ranking: Ranking) -> list[RankedEffect]:
    """Entries worth a refit: significant, the best first; physics and faults each get a hearing.

    Where the misfit is large the linear prediction is a poor judge: dissipative effects, say, are told apart
    by refits, not by scores. So many are begun and few are finished. Where it is small the prediction holds,
    and what would leave nearly all of the misfit, or explains less than an effect that does nothing, is not
    tried.
    """
    good = significant(ranking)
    if ranking.chi_square < LINEAR**2 * ranking.rows:
        beyond = ranking.chi_square - ranking.rows
        # Smooth decoys do as well as most effects before a refit: they exclude none that is near the best.
        most = good[0].statistic if good else 0.0
        floor = min(ranking.decoy_statistic, NEAR_BEST * most)
        good = [e for e in good if e.statistic > floor]
        # Where none takes its share, two that lead are all that is left to try.
        good = [e for e in good if e.statistic > WORTH_A_REFIT[e.kind] * beyond] or good[:LAST_RESORT]
    if not good:
        return []
    chosen = [e for e in good if e.statistic > WORTH_A_TRY * good[0].statistic][:BEGUN]
    for kind in ("smooth", "threshold", "measurement"):
        rest = [e for e in good if e.kind == kind]
        if rest and rest[0] not in chosen and rest[0].statistic > 0.02 * good[0].statistic:
            chosen.append(rest[0])
    return chosen


def refits_of(
    experiment: Experiment,
    current: Step,
    window: tuple[float, Solution],
    ranking: Ranking,
    spacing: float,
    generator: np.random.Generator,
    say: Callable[[str], None],
    *,
    afar: bool = False,
    onward: bool = True,
    fates: dict[str, str] | None = None,
) -> list[Refit]:
    """Refits of the promising entries, those that are closest after a few iterations brought to the end; of
    the other significant ones where none of these pays: what was promised is no guide then.

    onward: whether the others are asked for; afar: whether the window is seen from materials that were not
    fitted to it; fates: filled with why effects were not brought to the end.
    """
    fates = {} if fates is None else fates
    entries = promising(ranking)
    fates |= {e.effect: _unpromising(e) for e in ranking.entries if e not in entries}

    def refits(of: Sequence[RankedEffect], *, all_begun: bool) -> list[Refit]:
        return _refits(
            experiment, current, window, ranking, spacing, generator, say, of,
            afar=afar, fates=fates, all_begun=all_begun,
        )  # fmt: skip

    found = refits(entries, all_begun=False)
    if not onward or any(r.pays or r.may_pay for r in found):
        return found
    others = [e for e in significant(ranking) if e not in entries or fates[e.effect] == BEHIND][:BEGUN]
    if others:
        say(f"none of these pays; now {', '.join(entry.label for entry in others)}")
        found += refits(others, all_begun=True)
    return found


def _refits(
    experiment: Experiment,
    current: Step,
    window: tuple[float, Solution],
    ranking: Ranking,
    spacing: float,
    generator: np.random.Generator,
    say: Callable[[str], None],
    entries: Sequence[RankedEffect],
    *,
    afar: bool,
    fates: dict[str, str],
    all_begun: bool,
) -> list[Refit]:
    """Refits of some entries. all_begun: also of those that others leave far behind."""
    begun: list[Begun] = []
    # On all frames, and near the data: there the prediction holds, and a few iterations tell who leads.
    near = ranking.chi_square < LINEAR**2 * ranking.rows and window[0] == 1.0
    iterations = FIRST_AFAR if afar else FIRST_NEAR if near else FIRST
    accuracy = ACCURACY_AFAR if afar else ACCURACY
    countdown = Countdown(say, "refits begun", len(entries))
    for wave in waves(entries):
        best = min((chi_square for chi_square, _, _ in begun), default=np.inf)
        # From afar no first iteration says how far one leads, and a few frames cost little.
        hopeless = np.inf if afar else HOPELESS * best
        chosen = [entry for entry in wave if all_begun or not _far_behind(entry, ranking, begun)]
        fates |= {entry.effect: BEHIND for entry in wave if entry not in chosen}

        def start(twin: Experiment, entry: RankedEffect, hopeless: float = hopeless) -> Solution | None:
            return start_refit(
                twin,
                window[1],
                entry,
                spacing,
                share=window[0],
                iterations=iterations,
                hopeless=hopeless,
                accuracy=accuracy,
                report=say,
            )

        for entry, solution in zip(chosen, side_by_side(experiment, start, chosen), strict=True):
            if solution is not None:
                begun.append((solution.evaluation.chi_square, entry, solution))
            else:
                fates[entry.effect] = "cannot be simulated from its estimate"
        countdown.done(len(wave))
    # An effect at a wrong place is not what the others are to be held against.
    begun = with_places_fitted(experiment, begun, window[0], spacing, say, anywhere=afar)
    if afar:
        begun = restarted_from_best_materials(
            experiment, begun, window[0], spacing, generator.spawn(1)[0], say,
            iterations=iterations, accuracy=accuracy,
        )  # fmt: skip
    begun.sort(key=lambda item: item[0])
    fates |= {e.effect: _begun_only(fit, window[0]) for _, e, fit in begun}

    def finished(of: Sequence[Begun]) -> list[Refit]:
        return finish_closest(experiment, current, of, near, spacing, generator, say)

    if window[0] == 1.0 or not begun:
        return finished(begun)
    # Over a short window many effects do alike: a few iterations on all frames tell them apart. Where none of
    # those does any good there, a short window had the wrong ones in front.
    limit = ALIKE * begun[0][0]
    alike, behind = ([item for item in begun if (item[0] < limit) is side] for side in (True, False))
    found = finished(continued_to_all_frames(experiment, window[0], alike, spacing, say))
    if behind and not any(r.pays or r.may_pay for r in found):
        behind = behind[:FINISHED]
        say(f"none of these pays; now {', '.join(entry.label for _, entry, _ in behind)} on all frames")
        found += finished(continued_to_all_frames(experiment, window[0], behind, spacing, say))
    return found


def _unpromising(entry: RankedEffect) -> str:
    if entry.reason:
        return entry.reason
    if entry.p_value >= SIGNIFICANT or entry.statistic <= LEAST_DROP:
        return f"not told from noise, p {entry.p_value:.2g}"
    return "promises too little beside others"


def _begun_only(fit: Solution, share: float) -> str:
    frames = "" if share == 1.0 else f" of the first {100.0 * share:.0f} % of the frames"
    return f"begun, and left {fit.evaluation.misfit:.2f} sigma{frames}"


def _far_behind(entry: RankedEffect, ranking: Ranking, begun: Sequence[Begun]) -> bool:
    """Whether an entry stays behind what is reached even if it brings many times its promise; not where one
    that was begun has brought more times its own."""
    best = min((chi_square for chi_square, _, _ in begun), default=np.inf)
    times = BEYOND_TANGENTS if best > BUDGET_FLOOR * ranking.rows else BEYOND_NOISE
    least = ranking.chi_square - times * entry.statistic
    telling = entry.kind != "threshold" and ranking.chi_square < TELLING**2 * ranking.rows
    brought_more = any(
        ranking.chi_square - chi_square > times * other.statistic
        for chi_square, other, _ in begun
        if other.kind != "threshold"
    )
    return telling and least > ALIKE * best and not brought_more
