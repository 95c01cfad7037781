"""Refits from afar begun once more, from the materials that the best of them has found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mphygs.diagnose.rank import rank
from mphygs.diagnose.ranking import RankedEffect
from mphygs.extend.refit_beginning import start_refit
from mphygs.extend.window_continuation import LINEAR, Begun, with_places_fitted
from mphygs.fit.countdown import Countdown
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.side_by_side import side_by_side, waves
from mphygs.simulate.errors import SimulationError


def restarted_from_best_materials(
    experiment: Experiment,
    begun: Sequence[Begun],
    share: float,
    spacing: float,
    generator: np.random.Generator,
    say: Callable[[str], None],
    *,
    iterations: int,
    accuracy: float,
) -> list[Begun]:
    """The refits to a share of the frames, each from where it is or, where that leaves less, begun anew from
    the best one's materials.

    Loads that come with the first frame move the object much alike at first: the materials are nearly right
    with any of them once they are found, and hard to find from materials that are not, where the true load
    may stop short of its minimum. Nothing is begun anew where the best one is far from the data itself.
    """
    if len(begun) < 2:
        return list(begun)
    _, leader, fit = min(begun, key=lambda item: item[0])
    if fit.evaluation.misfit > LINEAR:
        return list(begun)
    problem = experiment.window(spacing, share)
    try:
        materials = fit.belief.without_effect(leader.effect)
        base = Solution(materials, problem.evaluate(materials), (), True, "lent")
    except SimulationError:
        return list(begun)
    others = [entry.effect for _, entry, _ in begun if entry is not leader and entry.kind != "threshold"]
    say(f"{', '.join(others)} from the materials found with {leader.effect}")
    ranking = rank(
        experiment, base.belief, base.evaluation, spacing, share=share, generator=generator,
        names=others, trials=False, report=None,
    )  # fmt: skip
    entries = [entry for entry in ranking.entries if entry.estimate]
    countdown = Countdown(say, "begun anew", len(entries))
    restarted: list[Begun] = []
    for wave in waves(entries):

        def start(twin: Experiment, entry: RankedEffect) -> Solution | None:
            return start_refit(
                twin, base, entry, spacing, share=share, iterations=iterations, accuracy=accuracy, report=say
            )

        for entry, solution in zip(wave, side_by_side(experiment, start, wave), strict=True):
            if solution is not None:
                restarted.append((solution.evaluation.chi_square, entry, solution))
        countdown.done(len(wave))
    found = {item[1].effect: item for item in with_places_fitted(experiment, restarted, share, spacing, say)}

    def better(item: Begun) -> Begun:
        chi_square, entry, _ = item
        other = found.get(entry.effect)
        if other is None or other[0] >= chi_square:
            return item
        # What it promised was promised from where the ranking was made.
        restart = other[1]
        entry = replace(entry, label=restart.label, start=restart.start, others=restart.others)
        return other[0], entry, other[2]

    return [better(item) for item in begun]
