"""Finite trials of what a derivative at the null says little of: thresholds, holds, weights of known loads.

Planes that a body may have met are searched for (`mphygs.diagnose.contact_search`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.capture.format import Capture
from mphygs.diagnose.ways import hung_label, levels, strengths
from mphygs.fit.placement import weights_of_loads
from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec, ParameterSpec
from mphygs.simulate.prediction import Predictor

# Of the largest stress that the model without the threshold reaches.
YIELD_SHARES = (0.8, 0.6, 0.4, 0.25, 0.12)
# The quantile that stands for the largest stress: single points at edges say too much.
LARGEST = 0.999
# How far a hold gives way under the object's weight, of the object's diagonal.
YIELDING = (3e-4, 1e-3, 3e-3, 1e-2)
# Of the mass whose weight a known load is.
MASS_SHARES = (0.5, 1.0)
# Values of a threshold's number over where it is tried; where it does not say that, times its usual size.
VALUES, ABOUT = 5, (0.1, 0.3, 1.0, 3.0)
# Of the logarithm of a level that was tried, the standard deviation of its prior.
LEVEL_PRIOR = 2.0


@dataclass(frozen=True, eq=False)
class Trial:
    """A belief with an effect at a finite value. label: what was tried."""

    effect: str
    label: str
    belief: Belief


def trials_of(
    spec: EffectSpec,
    capture: Capture,
    predictor: Predictor,
    belief: Belief,
    last: int,
    sequences: Sequence[str],
) -> list[Trial]:
    """Trials of an effect that a belief lacks and that no plane brings.

    predictor: of the sequence that is off most, in frames 0..last-1; sequences: those that are fitted.
    """
    trials: list[Trial] = []
    if spec.threshold:
        trials += threshold_trials(spec, predictor, belief, last)
    if spec.site == "hold":
        trials += hold_trials(spec, capture, belief)
    if spec.site == "mass":
        trials += hung_trials(spec, capture, belief, sequences)
    return trials


def threshold_trials(spec: EffectSpec, predictor: Predictor, belief: Belief, last: int) -> list[Trial]:
    """A threshold's levels, or strengths where it has none, with all else at its usual size.

    A stress is tried below the largest von Mises stress that the model without the threshold reaches at any
    point and frame, and above what it bears at the start, where it carries its weight and nothing yields;
    another number where its descriptor says, else about its usual size.
    """
    tried = [p for p in spec.of_role("level") if p.fitted] or [
        p for p in spec.of_role("strength") if p.fitted
    ]
    usual = {name: next(p.scale for p in spec.parameters if p.name == name) for name in strengths(spec)}
    trials = []
    for p in tried:
        for value in _values(p, predictor, belief, last):
            extended = belief.with_effect(spec.name, usual | {p.name: value})
            own = extended[f"{spec.name}.{p.name}"]
            if own.log:
                extended = extended.with_parameter(
                    own.key, prior_mean=float(np.log(value)), prior_std=LEVEL_PRIOR
                )
            trials.append(Trial(spec.name, f"{p.name.replace('_', ' ')} {value:.4g} {p.unit}", extended))
    return trials


def _values(p: ParameterSpec, predictor: Predictor, belief: Belief, last: int) -> list[float]:
    if p.unit == "Pa":
        stress = predictor.von_mises(belief, last)
        top, borne = (float(np.quantile(s, LARGEST)) for s in (stress, stress[0]))
        return [share * top for share in YIELD_SHARES if share * top > borne]
    low, high = p.range
    if 0.0 < low < high:
        return levels(p, VALUES)
    return [float(np.clip(k * p.scale, p.lower, p.upper)) for k in ABOUT]


def hold_trials(spec: EffectSpec, capture: Capture, belief: Belief) -> list[Trial]:
    """Holds that give way [m/N] by so much of the object under its weight; none where the numbers are others.

    A soft hold passes for soft material: fitted with a rigid one, it leaves the derivative little to say.
    """
    if not any(s.held for s in capture.sequences):
        return []
    gravity = float(np.linalg.norm(belief.gravity)) or 9.81
    mass = sum(part.volume * belief[f"{part.name}.density"].value for part in capture.parts)
    trials = []
    for p in spec.of_role("strength"):
        for share in YIELDING if p.unit == "m/N" else ():
            compliance = share * capture.diagonal / (mass * gravity)
            extended = belief.with_effect(spec.name, {p.name: compliance})
            trials.append(Trial(spec.name, f"{spec.name} {compliance:.3g} {p.unit}", extended))
    return trials


def hung_trials(
    spec: EffectSpec, capture: Capture, belief: Belief, sequences: Sequence[str]
) -> list[Trial]:
    """Known loads taken for what they most often are: weights that hang on the object, inertia and all.

    A load may weigh as much as what carries it. A derivative where it has no mass says little then.
    """
    gravity = float(np.linalg.norm(belief.gravity))
    if gravity == 0.0:
        return []
    (strength,), trials = strengths(spec), []
    for load, settings in weights_of_loads(capture, sequences):
        mass = float(np.linalg.norm(load.force)) / gravity
        for share in MASS_SHARES:
            extended = belief.with_effect(spec.name, {strength: share * mass}, settings)
            trials.append(Trial(spec.name, hung_label(spec, settings), extended))
    return trials
