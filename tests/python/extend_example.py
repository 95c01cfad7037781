"""Steps of the loop with misfits as wished, and a small recorded bar, for the tests of the loop's rules."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bar_capture import bar_belief, bar_capture
from mphygs.capture.format import Capture
from mphygs.compare.assess import Assessment
from mphygs.compare.verdict_floor import Floor
from mphygs.diagnose.held_out import GainInterval
from mphygs.diagnose.ranking import RankedEffect
from mphygs.extend.refit import Refit
from mphygs.extend.step import Step
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.problem import Evaluation
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor, Settings

SIGMA = 1e-4  # [m]
SPACING = 0.01


def assessment_of(*ratios: float, adequate: bool = False) -> Assessment:
    """Misfits [sigma] of as many sequences."""
    found = {f"s{k}": {"fit": ratio} for k, ratio in enumerate(ratios)}
    floor = Floor(
        chi_square=1.0, degrees=1, limit=1.0, level=0.01, p_value=1.0, p_value_low=1.0, blocks=(),
        block_ratio=np.zeros(0), block_p_values=np.zeros(0),
    )  # fmt: skip
    return Assessment(adequate, 1.0, found, floor, [], [], {})


def excess_of(value: float) -> Assessment:
    """An assessment with this mean square beyond noise."""
    return assessment_of(float(np.sqrt(1.0 + value)))


def evaluation_of(chi_square: float, rows: int = 100, names: Sequence[str] = ("a",)) -> Evaluation:
    """An evaluation with this sum of squares in each sequence's rows."""
    residual = np.full(rows * len(names), np.sqrt(chi_square / rows))
    spans = {name: slice(k * rows, (k + 1) * rows) for k, name in enumerate(names)}
    return Evaluation(residual, np.zeros((len(residual), 0)), len(residual), 0, spans, {}, 1)


def solution_of(belief: Belief, evaluation: Evaluation) -> Solution:
    return Solution(belief, evaluation, (evaluation.cost,), True, "as wished")


def plain_belief(free: int = 1) -> Belief:
    """A bar's belief with so many free parameters."""
    keys = ("part0.youngs_modulus", "part0.density", "part0.poissons_ratio")
    return bar_belief(bar_capture(), free=keys[:free])


def step_of(
    assessment: Assessment,
    *,
    added: Sequence[str] = (),
    free: int = 1,
    spacing: float = SPACING,
    chi_square: float = 100.0,
) -> Step:
    belief = plain_belief(free)
    solution = solution_of(belief, evaluation_of(chi_square))
    return Step(belief, solution, {}, assessment, spacing, tuple(added))


def entry_of(
    name: str, statistic: float, *, p_value: float = 1e-9, kind: str = "smooth", start: Belief | None = None
) -> RankedEffect:
    return RankedEffect(name, name, kind, statistic, p_value, 1.0, {}, {}, start or plain_belief())


def refit_of(
    *,
    gain: GainInterval | None,
    chi_square: float = 100.0,
    drop: float = 100.0,
    statistic: float = 100.0,
    assessment: Assessment | None = None,
) -> Refit:
    belief = plain_belief()
    return Refit(
        entry_of("viscosity", statistic), solution_of(belief, evaluation_of(chi_square)), {},
        assessment or assessment_of(1.0), gain, drop,
    )  # fmt: skip


def recorded(capture: Capture, truth: Belief, spacing: float = SPACING) -> Capture:
    """The capture with the markers of all its sequences simulated at the truth, noise added."""
    noise = np.random.default_rng(5)
    sequences = []
    for recording in capture.sequences:
        position = Predictor(capture, recording, Settings(spacing, workers=1)).predict(truth).position
        position = position + SIGMA * noise.standard_normal(position.shape)
        sequences.append(replace(recording, markers=replace(recording.markers, position=position)))
    return replace(capture, sequences=tuple(sequences))
