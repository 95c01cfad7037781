"""Effects that are another one with more numbers: whatever that one explains they explain as well."""

from __future__ import annotations

from collections.abc import Iterable

# Effects that are another one where some of their parameters are zero: that one, and these parameters.
SPECIAL = {"wind": ("air_drag", ("w_x", "w_y", "w_z"))}


def simple_of(name: str) -> str | None:
    """The effect that an effect is with some of its parameters zero, None where it is none."""
    return SPECIAL[name][0] if name in SPECIAL else None


def wider_than(name: str, among: Iterable[str]) -> tuple[str, ...]:
    """Those of some effects that an effect is a special case of."""
    return tuple(dict.fromkeys(other for other in among if simple_of(other) == name))
