"""Decoy effects: as smooth in time and space as the real candidates, and known to be absent.

What share of them the test calls significant is its false-alarm level on these very data; and a real effect
has to stand out from them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mphygs.diagnose.multiplicity import simulate_family
from mphygs.diagnose.score_table import Score, ScoreTable

Array = NDArray[np.float64]

# Modes over time that together hold less than this share of the tangents' power are left out.
NEGLIGIBLE_POWER = 1e-8


def decoy_tangents(tangents: Array, count: int, *, generator: np.random.Generator) -> Array:
    """Random responses (T, M, C, count) with the time and space covariance of the candidates' (T, M, C, Q).

    Every column of the tangents counts alike, whatever its unit. A decoy is a random mixture of the modes
    over time times the modes over markers, with the variances those modes have over the candidates (matrix-
    normal), scaled to unit length. Whiten them with the candidates' whitener. Raises ValueError when no
    tangent moves.
    """
    frames, markers, coordinates, columns = tangents.shape
    stacked = tangents.reshape(frames, markers * coordinates, columns)
    length = np.sqrt((stacked**2).sum((0, 1)))
    if not length.any():
        raise ValueError("decoys: expected at least one tangent that moves")
    unit = stacked[:, :, length > 0.0] / length[length > 0.0]
    over_time = unit.reshape(frames, -1)
    power, modes = np.linalg.eigh(over_time @ over_time.T)
    kept = power > NEGLIGIBLE_POWER * power[-1]
    time_modes = modes[:, kept] * np.sqrt(power[kept])
    projected = np.tensordot(modes[:, kept].T, unit, axes=1)
    over_space = projected.transpose(1, 0, 2).reshape(markers * coordinates, -1)
    left, singular, _ = np.linalg.svd(over_space, full_matrices=False)
    space_modes = (left * singular)[:, singular > np.sqrt(NEGLIGIBLE_POWER) * singular[0]]
    mixture = generator.standard_normal((count, time_modes.shape[1], space_modes.shape[1]))
    decoys = np.einsum("ta,nab,sb->tsn", time_modes, mixture, space_modes, optimize=True)
    decoys /= np.sqrt((decoys**2).sum((0, 1)))
    return decoys.reshape(frames, markers, coordinates, count)


@dataclass(frozen=True, kw_only=True)
class DecoyCheck:
    """Outcome of testing D decoys on the data.

    false_alarm_share: of decoys with a p-value up to `level`. p_value: chance of so large a share if the
    noise model held and nothing were missing, decoys being alike taken into account. inflation: their mean
    drop over its expectation, about 1 then; above it either noise or discretisation is understated or
    something is missing. p_values: (D,).
    """

    level: float
    false_alarm_share: float
    p_value: float
    inflation: float
    p_values: Array

    def stands_out(self, score: Score) -> float:
        """Share of decoys at least as significant as this candidate, which itself counts as one."""
        return float((1.0 + np.count_nonzero(self.p_values <= score.p_value)) / (1.0 + len(self.p_values)))


def check_decoys(
    table: ScoreTable, *, generator: np.random.Generator, level: float = 0.05, draws: int = 2000
) -> DecoyCheck:
    """Empirical false-alarm level from the scores of decoys. Raises ValueError when none is testable."""
    tested = [score for score in table.scores if score.testable]
    if not tested:
        raise ValueError("decoys: expected at least one that the fitted parameters do not absorb")
    p_values = np.array([score.p_value for score in tested])
    alarms = np.count_nonzero(p_values <= level)
    law = simulate_family(table, generator=generator, draws=draws)
    simulated = (law.p_values <= level).sum(1)
    drop = np.mean([score.drop for score in tested])
    expected = np.mean([score.weights @ np.arange(len(score.weights)) for score in tested])
    return DecoyCheck(
        level=level,
        false_alarm_share=alarms / len(tested),
        p_value=float((1.0 + np.count_nonzero(simulated >= alarms)) / (1.0 + draws)),
        inflation=float(drop / expected),
        p_values=p_values,
    )
