"""Finite trials of threshold effects: yields that the fitted model exceeds. Walls are searched for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor

YIELD_SHARES = (0.8, 0.6, 0.4, 0.25, 0.12)


@dataclass(frozen=True, eq=False)
class Trial:
    """A belief with a threshold effect at a finite value. label: what was tried."""

    effect: str
    label: str
    belief: Belief


def largest_shear_stress(predictor: Predictor, belief: Belief, last: int) -> float:
    """Largest von Mises stress of the base law at any quadrature point and output frame [Pa]."""
    return float(np.quantile(predictor.von_mises(belief, last), 0.999))


def plasticity_trials(predictor: Predictor, belief: Belief, last: int) -> list[Trial]:
    """Yield stresses below the largest stress that the fitted elastic model reaches."""
    if "plasticity" in belief.effects:
        return []
    top = largest_shear_stress(predictor, belief, last)
    trials = []
    for share in YIELD_SHARES:
        extended = belief.with_effect("plasticity", {"yield_stress": share * top})
        extended = extended.with_parameter(
            "plasticity.yield_stress", prior_mean=float(np.log(share * top)), prior_std=2.0
        )
        trials.append(Trial("plasticity", f"yield stress {share * top:.4g} Pa", extended))
    return trials
