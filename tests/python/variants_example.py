"""Ways of some effects as tests ask for them, by name."""

from __future__ import annotations

import numpy as np

from mphygs.diagnose import wall
from mphygs.diagnose.effect_variants import LATE, EffectVariant, flow_variant, placed_variant
from mphygs.diagnose.interpolated_places import variants_between
from mphygs.diagnose.wall import Plane
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.body import Body

WALL_EFFECT = effect("contact")


def mass_way(belief: Belief, place: np.ndarray, digits: int = 3, *, late: bool = False) -> EffectVariant:
    return placed_variant(belief, effect("attached_mass"), place, digits, LATE if late else {})


def wind_way(belief: Belief, direction: np.ndarray, *, late: bool = False) -> EffectVariant:
    return flow_variant(belief, effect("wind"), direction, LATE if late else {})


def between(
    belief: Belief,
    body: Body,
    ways: list[EffectVariant],
    tangents: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
    *,
    late: bool = False,
) -> EffectVariant | None:
    """The one further way between some that came later, or did not."""
    found = variants_between(belief, body, ways, tangents, residual, jacobian)
    own = [way for way in found if (way.settings.get("at_rest") is False) is late]
    assert len(own) < 2
    return own[0] if own else None


def with_wall(belief: Belief, plane: Plane) -> Belief:
    return wall.with_wall(belief, WALL_EFFECT, plane)
