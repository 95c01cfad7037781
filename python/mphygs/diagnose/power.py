"""The smallest effect that would have been seen, to stand beside every "not found"."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import norm

from mphygs.diagnose.cone import mixture_p_value
from mphygs.diagnose.score_table import Score

Array = NDArray[np.float64]


def detectable_length(score: Score, *, level: float, family: int, power: float = 0.8) -> float:
    """Length |P j e| an effect needs to be found with probability `power` among `family` candidates.

    sqrt(c) + z_power with c the gain that is significant at level / family: for one bounded parameter this is
    z_{1 - level/family} + z_power. With several parameters it errs by asking for slightly too much.
    Raises ValueError when the candidate is not testable.
    """
    if not score.testable:
        raise ValueError(f"{score.name}: not testable ({score.reason}), no strength would have been seen")
    target = np.log(level / family)
    critical = brentq(lambda g: np.log(float(mixture_p_value(g, score.weights))) - target, 1e-12, 1e3)
    return float(np.sqrt(critical) + norm.ppf(power))


def detectable_strength(score: Score, *, level: float, family: int, power: float = 0.8) -> Array:
    """(q,) smallest magnitude of each parameter, alone, that would have been seen; its own units.

    Infinite where the motion says nothing. (z_{1 - level/family} + z_power) / sqrt(I) for one bounded
    parameter.
    """
    if not score.testable:
        return np.full(score.parameter_count, np.inf)
    length = detectable_length(score, level=level, family=family, power=power)
    diagonal = np.maximum(np.diag(score.information), 0.0)
    visible = diagonal > 1e-12 * diagonal.max()
    return np.where(visible, length / np.sqrt(np.where(visible, diagonal, 1.0)), np.inf)


def detectable_along(
    score: Score, direction: Array, *, level: float, family: int, power: float = 0.8
) -> float:
    """Smallest magnitude along a direction (q,), normalised here, whose parameters share a unit."""
    unit = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    information = float(unit @ score.information @ unit)
    if not score.testable or information <= 1e-12 * float(np.diag(score.information).max()):
        return float("inf")
    return detectable_length(score, level=level, family=family, power=power) / float(np.sqrt(information))


def least_visible_direction(score: Score) -> Array:
    """(q,) unit direction in which an effect whose parameters share a unit is seen worst."""
    return np.linalg.eigh(score.information)[1][:, 0]
