"""A wall in a model: the plane where it stands, and its friction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec, ParameterSpec
from mphygs.model.registry import effect

# Of a direction's components, and of a strength in its usual size, the standard deviations of their priors.
DIRECTION_PRIOR, STRENGTH_PRIOR = 0.5, 2.0


@dataclass(frozen=True, eq=False)
class Plane:
    """normal . x >= offset. normal: (3,) unit; offset: [m]; chi_square: of the model with it, inf where no
    run was made."""

    normal: np.ndarray
    offset: float
    chi_square: float = np.inf

    @property
    def label(self) -> str:
        """The plane in words, n and d [m]."""
        return "plane n = ({:.2f}, {:.2f}, {:.2f}), d = {:.4f} m".format(*self.normal, self.offset)


def with_wall(belief: Belief, spec: EffectSpec, plane: Plane) -> Belief:
    """A belief with an effect that a plane brings, its place, direction and strengths free."""
    (offset,), strengths = spec.of_role("offset"), _strengths(spec)
    normal = {p.name: float(x) for p, x in zip(spec.of_role("direction"), plane.normal, strict=True)}
    slight = {p.name: p.range[0] for p in strengths}
    extended = belief.with_effect(spec.name, {offset.name: plane.offset} | slight | normal)
    for name, value in normal.items():
        # Only the direction counts; the prior keeps its length.
        extended = extended.with_parameter(
            f"{spec.name}.{name}", free=True, scale=0.1, prior_mean=value, prior_std=DIRECTION_PRIOR
        )
    for p in strengths:
        key = f"{spec.name}.{p.name}"
        extended = extended.with_parameter(key, prior_mean=p.scale, prior_std=STRENGTH_PRIOR * p.scale)
    return extended


def _strengths(spec: EffectSpec) -> list[ParameterSpec]:
    return [p for p in spec.of_role("strength") if p.fitted]


def _met(belief: Belief) -> list[EffectSpec]:
    """The effects of a belief that planes bring."""
    return [spec for name in belief.effects if (spec := effect(name)).of_role("offset")]


def hold_friction(belief: Belief) -> Belief:
    """The belief with the friction of its walls held at a usual value, where it has any.

    Far from the data the first linear step puts the friction to zero, where it stays, and the normal leans
    to make up for it: the wall's place and direction are found first.
    """
    for spec in _met(belief):
        for p in _strengths(spec):
            belief = belief.with_parameter(f"{spec.name}.{p.name}", value=p.scale, free=False)
    return belief


def release_friction(belief: Belief) -> Belief:
    """The belief with the friction of its walls free, where it has any."""
    for spec in _met(belief):
        for p in _strengths(spec):
            belief = belief.with_parameter(f"{spec.name}.{p.name}", free=True)
    return belief
