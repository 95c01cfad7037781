"""Effects that are another one with more numbers: whatever that one explains they explain as well."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from mphygs.extend.refit import in_logarithm
from mphygs.model.belief import Belief
from mphygs.model.materials import lame

# Effects that are another one where some of their parameters are zero: that one, and these parameters.
SPECIAL = {"wind": ("air_drag", ("w_x", "w_y", "w_z"))}


# An effect that becomes another one as a time of its own goes to zero; the time, in units of that between
# frames, below which no frame tells the two apart, and below which one may lead to the other.
LIMITS = {"relaxation": "viscosity"}
SHORT, SHORT_ENOUGH = 0.5, 2.0


def simple_of(name: str) -> str | None:
    """The effect that an effect is with some of its parameters zero, None where it is none."""
    return SPECIAL[name][0] if name in SPECIAL else None


def wider_than(name: str, among: Iterable[str]) -> tuple[str, ...]:
    """Those of some effects that an effect is a special case of."""
    return tuple(dict.fromkeys(other for other in among if simple_of(other) == name))


def without_memory(belief: Belief, fps: float, *, short: float = SHORT) -> Belief | None:
    """The belief with a viscosity in the place of a relaxation that is over in a short time; None where it
    has no such relaxation. fps: frames per second; short: in units of the time between frames.

    Q' + Q / tau = ratio S' is Q = ratio tau S' as tau goes to zero: a viscosity of ratio tau mu.
    """
    if "relaxation" not in belief.effects or "viscosity" in belief.effects:
        return None
    ratio, tau = (belief[f"relaxation.{name}"].value for name in ("ratio", "tau"))
    if tau > short / fps:
        return None
    moduli, ratios = (
        np.array([belief[f"{name}.{key}"].value for name in belief.parts])
        for key in ("youngs_modulus", "poissons_ratio")
    )
    eta = ratio * tau * float(np.exp(np.mean(np.log(lame(moduli, ratios)[0]))))
    after = belief.without_effect("relaxation").with_effect("viscosity", {"eta": eta})
    p = in_logarithm(after["viscosity.eta"])
    return after.with_parameter(p.key, log=p.log, lower=p.lower, value=p.value)
