"""Finite trials of what no derivative at the null tells much of: thresholds, holds, weights of loads, laws.

Planes that a body may have met are searched for (`mphygs.diagnose.contact_search`), levels of thresholds are
scanned (`mphygs.diagnose.thresholds`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.capture.format import Capture
from mphygs.diagnose.effect_variants import hanging_mass_label, strengths
from mphygs.diagnose.thresholds import threshold_trials
from mphygs.fit.placement import weights_of_loads
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec
from mphygs.simulate.section import part_mass

# How far a hold gives way under the object's weight, of the object's diagonal.
YIELDING = (3e-4, 1e-3, 3e-3, 1e-2)
# Of the mass whose weight a known load is.
MASS_SHARES = (0.5, 1.0)
# Of the sum of squares of noise, standard deviations up to which no other law is tried.
SPREAD = 3.0


@dataclass(frozen=True, eq=False)
class Trial:
    """A belief with an effect at a finite value. label: what was tried."""

    effect: str
    label: str
    belief: Belief


def trials_of(
    spec: EffectSpec,
    capture: Capture,
    problem: Problem,
    belief: Belief,
    evaluation: Evaluation,
) -> list[Trial]:
    """Trials of an effect that a belief lacks and that no plane brings. evaluation: of the belief, with
    Jacobian."""
    trials: list[Trial] = []
    if spec.threshold:
        found = threshold_trials(spec, problem, belief, evaluation)
        trials += (Trial(spec.name, label, extended) for label, extended in found)
    if spec.site == "hold":
        trials += hold_trials(spec, capture, belief)
    if spec.site == "mass":
        trials += hanging_mass_trials(spec, capture, belief, list(problem.ranges))
    if spec.site == "law" and not _at_noise(evaluation):
        trials.append(Trial(spec.name, f"law {spec.name}", belief.with_effect(spec.name)))
    return trials


def _at_noise(evaluation: Evaluation) -> bool:
    """Whether noise alone may leave as much, by the spread of its sum of squares."""
    rows = evaluation.data_rows
    return evaluation.chi_square <= rows + SPREAD * np.sqrt(2.0 * rows)


def hold_trials(spec: EffectSpec, capture: Capture, belief: Belief) -> list[Trial]:
    """Holds that give way [m/N] by so much of the object under its weight; none where the numbers are others.

    A soft hold passes for soft material: fitted with a rigid one, it leaves the derivative little to say.
    """
    if not any(s.held for s in capture.sequences):
        return []
    gravity = float(np.linalg.norm(belief.gravity)) or 9.81
    mass = sum(part_mass(belief, part) for part in capture.parts)
    trials = []
    for p in spec.of_role("strength"):
        for share in YIELDING if p.unit == "m/N" else ():
            compliance = share * capture.diagonal / (mass * gravity)
            extended = belief.with_effect(spec.name, {p.name: compliance})
            trials.append(Trial(spec.name, f"{spec.name} {compliance:.3g} {p.unit}", extended))
    return trials


def hanging_mass_trials(
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
            trials.append(Trial(spec.name, hanging_mass_label(spec, settings), extended))
    return trials
