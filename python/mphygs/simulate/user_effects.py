"""Which effects of a belief run in Python, and the hook that carries them. torch is loaded only for these."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import effect
from mphygs.simulate.body import Body

if TYPE_CHECKING:
    from mphygs.simulate.user_forces import UserForces


def user_effects(belief: Belief) -> tuple[str, ...]:
    """Names of the belief's effects that run in Python."""
    return tuple(t.name for t in belief.terms if effect(t.name).site == "user")


def forces_of(
    belief: Belief,
    body: Body,
    dtype: type,
    mass: np.ndarray,
    *,
    simulated: Sequence[tuple[Belief, Parameter]] = (),
    changes: Sequence[dict[str, np.ndarray]] = (),
) -> UserForces | None:
    """The hook of a belief's effects in Python and of those that the owners of parameters add, if any.

    mass: (B, 8) [kg]; simulated: (belief, parameter) of every direction; changes: its change of the core's
    fields, of which the mass matters here.
    """
    names = list(user_effects(belief))
    owners = {name: belief for name in names}
    for owner, _ in simulated:
        for name in user_effects(owner):
            if name not in owners:
                names.append(name)
                owners[name] = owner
    if not names:
        return None
    from mphygs.simulate.user_forces import UserForces

    keys = [f"{name}.{p.name}" for name in names for p in effect(name).parameters]
    values = np.array([owners[key.rsplit(".", 1)[0]][key].value for key in keys])
    directions = []
    for (_, parameter), change in zip(simulated, changes, strict=True):
        moved = np.array([parameter.slope if key == parameter.key else 0.0 for key in keys])
        directions.append((moved, change.get("mass")))
    return UserForces(names, values, mass=mass, body=body, dtype=dtype, directions=directions)
