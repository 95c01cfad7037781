"""Finite trials: yields that the fitted model exceeds, masses of known loads. Walls are searched for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.capture.format import Capture
from mphygs.fit.placement import weights_of_loads
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor

YIELD_SHARES = (0.8, 0.6, 0.4, 0.25, 0.12)
# The quantile that stands for the largest stress: single points at edges say too much.
LARGEST = 0.999
# How far a hold gives way under the object's weight, of the object's diagonal.
YIELDING = (3e-4, 1e-3, 3e-3, 1e-2)
# Of the mass whose weight a known load is.
MASS_SHARES = (0.5, 1.0)


@dataclass(frozen=True, eq=False)
class Trial:
    """A belief with an effect at a finite value. label: what was tried."""

    effect: str
    label: str
    belief: Belief


def plasticity_trials(predictor: Predictor, belief: Belief, last: int) -> list[Trial]:
    """Yield stresses below the largest von Mises stress that the fitted elastic model reaches at any point
    and frame; above what it bears at the start, where it carries its weight and does not flow."""
    if "plasticity" in belief.effects:
        return []
    stress = predictor.von_mises(belief, last)
    top, borne = (float(np.quantile(s, LARGEST)) for s in (stress, stress[0]))
    trials = []
    for share in YIELD_SHARES:
        if share * top <= borne:
            break
        extended = belief.with_effect("plasticity", {"yield_stress": share * top})
        extended = extended.with_parameter(
            "plasticity.yield_stress", prior_mean=float(np.log(share * top)), prior_std=2.0
        )
        trials.append(Trial("plasticity", f"yield stress {share * top:.4g} Pa", extended))
    return trials


def compliance_trials(capture: Capture, belief: Belief) -> list[Trial]:
    """Holds that give way.

    A soft hold passes for soft material: fitted with a rigid one, it leaves the derivative little to say.
    """
    if "hold_compliance" in belief.effects or not any(s.held for s in capture.sequences):
        return []
    gravity = float(np.linalg.norm(belief.gravity)) or 9.81
    mass = sum(part.volume * belief[f"{part.name}.density"].value for part in capture.parts)
    trials = []
    for share in YIELDING:
        compliance = share * capture.diagonal / (mass * gravity)
        extended = belief.with_effect("hold_compliance", {"compliance": compliance})
        trials.append(Trial("hold_compliance", f"hold_compliance {compliance:.3g} m/N", extended))
    return trials


def hung_trials(capture: Capture, belief: Belief, sequences: Sequence[str]) -> list[Trial]:
    """Known loads taken for what they most often are: weights that hang on the object, inertia and all.

    A load may weigh as much as what carries it. A derivative where it has no mass says little then.
    """
    gravity = float(np.linalg.norm(belief.gravity))
    if "attached_mass" in belief.effects or gravity == 0.0:
        return []
    trials = []
    for load, settings in weights_of_loads(capture, sequences):
        mass = float(np.linalg.norm(load.force)) / gravity
        for share in MASS_SHARES:
            extended = belief.with_effect("attached_mass", {"m": share * mass}, settings)
            trials.append(Trial("attached_mass", hung_label(settings), extended))
    return trials


def hung_label(settings: dict[str, object]) -> str:
    """What a point mass is called that a known load is the weight of."""
    return f"attached_mass, the load of {', '.join(settings['sequences'])}"
