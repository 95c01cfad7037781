"""Candidates ranked where the model that lacks one of them is nearly right."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mphygs.compare.allowance import Allowance
from mphygs.diagnose.effect_variants import drives_body
from mphygs.diagnose.grid_error import allowance_of
from mphygs.diagnose.rank import rank
from mphygs.diagnose.ranking import Ranking
from mphygs.extend.first_window import at_other_scales, tractable_window
from mphygs.extend.step import Step
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.model.registry import effects


def ranked_on_window(
    experiment: Experiment,
    current: Step,
    spacing: float,
    generator: np.random.Generator,
    *,
    names: Sequence[str] | None = None,
    report: Callable[[str], None] | None = None,
) -> tuple[tuple[float, Solution], bool, Ranking]:
    """The share of the fitted frames that a step's model is diagnosed on with the model there, whether that
    is one of materials that were not fitted, and the candidates ranked there.

    names: effects that may be added (None: all).
    """
    say = report or (lambda _text: None)
    window = tractable_window(experiment, current, spacing, say)
    afar = _from_soft_materials(experiment, window, spacing, generator, names, report)
    if afar is not None:
        window = window[0], afar

    share, fitted = window
    # From afar the grid's error is that of another motion: no share of what is left there.
    allowance = (
        allowance_of(experiment, spacing, fitted.belief, fitted.evaluation, share=share)
        if afar is None
        else Allowance()
    )
    ranking = rank(
        experiment, fitted.belief, fitted.evaluation, spacing,
        share=share, generator=generator, names=names, allowance=allowance, report=report,
    )  # fmt: skip
    return window, afar is not None, ranking


def _from_soft_materials(
    experiment: Experiment,
    window: tuple[float, Solution],
    spacing: float,
    generator: np.random.Generator,
    names: Sequence[str] | None,
    report: Callable[[str], None] | None,
) -> Solution | None:
    """Where a first model is far off even on the first few frames: these frames seen with all parts as soft
    as usual, at the scale at which a load promises to leave least."""
    best, least = None, np.inf
    # What tells common scales of the materials apart where something acts from the start on.
    pushing = [name for name, spec in effects().items() if drives_body(spec)]
    loads = pushing if names is None else [name for name in pushing if name in names] or names
    for solution in at_other_scales(experiment, window, spacing):
        ranking = rank(
            experiment, solution.belief, solution.evaluation, spacing, share=window[0],
            generator=generator.spawn(1)[0], names=loads, trials=False, report=report,
        )  # fmt: skip
        left = ranking.chi_square - max((entry.statistic for entry in ranking.entries), default=0.0)
        if left < least:
            best, least = solution, left
    if best is not None and report:
        young = [best.belief[f"{part}.youngs_modulus"].value for part in best.belief.parts]
        misfit = best.evaluation.misfit
        report(f"seen with all parts at {1e-3 * np.median(young):.3g} kPa: {misfit:.3f} sigma")
    return best
