"""Finite trials of what a derivative at the null says nothing of, or little: thresholds, what is felt over
decades, weights of known loads. Planes that a body may have met are searched for
(`mphygs.diagnose.planes`)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.capture.format import Capture
from mphygs.diagnose.planes import Plane
from mphygs.diagnose.ways import hung_label, levels, missing, strengths
from mphygs.fit.placement import weights_of_loads
from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec

# Values of a threshold's level, and of a strength that is tried over decades.
THRESHOLDS, DECADES = 13, 5
# Of a threshold that says nothing of where it is tried, times its usual size.
ABOUT = (0.1, 0.3, 1.0, 3.0)
# Of the mass whose weight a known load is.
MASS_SHARES = (0.5, 1.0)
# Standard deviation of the logarithm of a level that was tried; of a direction's components.
LEVEL_PRIOR, DIRECTION_PRIOR = 2.0, 0.5


@dataclass(frozen=True, eq=False)
class Trial:
    """A belief with an effect at a finite value. label: what was tried."""

    effect: str
    label: str
    belief: Belief


def trials_of(
    belief: Belief,
    capture: Capture,
    transfer: str,
    sequences: Sequence[str],
    planes: Sequence[Plane] = (),
    *,
    names: Sequence[str] | None = None,
) -> list[Trial]:
    """All trials of effects that a belief lacks. planes: that the body may have met; sequences: fitted."""
    found: list[Trial] = []
    for spec in missing(belief, transfer, names):
        if spec.site == "hold" and not any(s.held for s in capture.sequences):
            continue
        if spec.of_role("offset"):
            found += (met(belief, spec, plane) for plane in planes)
        elif spec.threshold:
            found += _thresholds(belief, spec)
        elif not spec.scanned and not spec.settings:
            found += _over_decades(belief, spec)
        if spec.site == "mass":
            found += hung(belief, spec, capture, sequences)
    return found


def _thresholds(belief: Belief, spec: EffectSpec) -> Iterator[Trial]:
    scanned = [p for p in spec.of_role("level") if p.fitted] or [
        p for p in spec.of_role("strength") if p.fitted
    ]
    usual = {name: next(p.scale for p in spec.parameters if p.name == name) for name in strengths(spec)}
    for p in scanned:
        known = levels(p, THRESHOLDS) if p.scan else [k * p.scale for k in ABOUT]
        for value in known:
            there = belief.with_effect(spec.name, usual | {p.name: value})
            own = there[f"{spec.name}.{p.name}"]
            if own.log:
                there = there.with_parameter(own.key, prior_mean=float(np.log(value)), prior_std=LEVEL_PRIOR)
            yield Trial(spec.name, f"{spec.name}, {p.name} {value:.3g} {p.unit}", there)


def _over_decades(belief: Belief, spec: EffectSpec) -> Iterator[Trial]:
    """A soft hold, say, passes for soft material: fitted with a rigid one, it leaves the derivative little to
    say."""
    for p in spec.of_role("strength"):
        if p.fitted and p.range[1] > p.range[0]:
            for value in levels(p, DECADES):
                there = belief.with_effect(spec.name, {p.name: value})
                yield Trial(spec.name, f"{spec.name} {value:.3g} {p.unit}", there)


def hung(belief: Belief, spec: EffectSpec, capture: Capture, sequences: Sequence[str]) -> Iterator[Trial]:
    """Known loads taken for what they most often are: weights that hang on the object, inertia and all.

    A load may weigh as much as what carries it. A derivative where it has no mass says little then.
    """
    gravity = float(np.linalg.norm(belief.gravity))
    if gravity == 0.0:
        return
    (strength,) = strengths(spec)
    for load, settings in weights_of_loads(capture, sequences):
        mass = float(np.linalg.norm(load.force)) / gravity
        for share in MASS_SHARES:
            yield Trial(
                spec.name,
                hung_label(spec, settings),
                belief.with_effect(spec.name, {strength: share * mass}, settings),
            )


def met(belief: Belief, spec: EffectSpec, plane: Plane) -> Trial:
    """A plane that is met, its place, direction and strengths free."""
    (offset,) = spec.of_role("offset")
    normal = {p.name: x for p, x in zip(spec.of_role("direction"), plane.normal, strict=True)}
    slight = {p.name: p.range[0] for p in spec.of_role("strength") if p.fitted}
    there = belief.with_effect(spec.name, {offset.name: plane.offset} | slight | normal)
    for name, value in normal.items():
        # Only the direction counts; the prior keeps its length.
        there = there.with_parameter(
            f"{spec.name}.{name}", free=True, scale=0.1, prior_mean=value, prior_std=DIRECTION_PRIOR
        )
    for p in spec.of_role("strength"):
        if p.fitted:
            there = there.with_parameter(f"{spec.name}.{p.name}", prior_mean=p.scale, prior_std=2.0 * p.scale)
    return Trial(spec.name, plane.label, there)
