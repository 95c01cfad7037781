"""Effects that are another one with more numbers: whatever that one explains they explain as well.

An effect says which: it is the simpler one where its flow is nothing, or as its level, a time, goes to zero.
"""

from __future__ import annotations

import numpy as np

from mphygs import _core
from mphygs.extend.refit_beginning import in_logarithm
from mphygs.model.belief import Belief
from mphygs.model.materials import lame
from mphygs.model.registry import effect

# The time, in units of that between frames, below which no frame tells an effect from its limit.
SHORT = 0.5


def without_flow(name: str) -> str | None:
    """The effect that an effect is with its flow at zero, None where it is none."""
    spec = effect(name)
    return spec.simpler or None if spec.of_role("flow") else None


def without_level(name: str) -> str | None:
    """The effect that an effect becomes as its level goes to zero, None where it is none."""
    spec = effect(name)
    return spec.simpler or None if spec.of_role("level") else None


def flow_numbers(name: str) -> tuple[str, ...]:
    """The numbers of an effect that are zero where it is the simpler one."""
    return tuple(p.name for p in effect(name).of_role("flow"))


def at_short_time_limit(belief: Belief, wide: str, fps: float) -> Belief | None:
    """The belief with its limit in the place of an effect whose time is over soon; None where it has it not,
    or it takes longer. fps: frames per second."""
    simple = without_level(wide)
    if simple is None or wide not in belief.effects or simple in belief.effects:
        return None
    spec = effect(wide)
    if any(belief[f"{wide}.{p.name}"].value > SHORT / fps for p in spec.of_role("level")):
        return None
    moduli, ratios = (
        np.array([belief[f"{name}.{key}"].value for name in belief.parts])
        for key in ("youngs_modulus", "poissons_ratio")
    )
    shear = float(np.exp(np.mean(np.log(lame(moduli, ratios)[0]))))
    own = {p.name: belief[f"{wide}.{p.name}"].value for p in spec.parameters}
    numbers = _core.simplified(wide, np.array(list(own.values())), shear) if spec.in_core else []
    values = {p.name: own[p.name] for p in effect(simple).parameters if p.name in own}
    values |= {p.name: float(x) for p, x in zip(effect(simple).parameters, numbers, strict=False)}
    after = belief.without_effect(wide).with_effect(simple, values)
    for name in values:
        p = in_logarithm(after[f"{simple}.{name}"])
        after = after.with_parameter(p.key, log=p.log, lower=p.lower, value=p.value)
    return after
