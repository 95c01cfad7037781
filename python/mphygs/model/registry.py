"""The effects that can be named: those of the core, those of the measurement, and the user's own.

One table that the command line, diagnosis, reports and tests read. Names, units and null values are
those of the public list of effects.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

from mphygs import _core


@dataclass(frozen=True)
class ParameterSpec:
    """One number of an effect. null: value at which the effect is absent; scale: a usual size."""

    name: str
    unit: str
    null: float
    lower: float
    upper: float
    scale: float
    fitted: bool = True


@dataclass(frozen=True)
class EffectSpec:
    """kind: "smooth", "threshold" or "measurement"; site: where it acts in the simulation."""

    name: str
    summary: str
    kind: str
    site: str
    parameters: tuple[ParameterSpec, ...] = field(default_factory=tuple)

    @property
    def fitted(self) -> tuple[ParameterSpec, ...]:
        """The parameters that a fit changes."""
        return tuple(p for p in self.parameters if p.fitted)


def _core_effects() -> list[EffectSpec]:
    specs = []
    for entry in _core.effects():
        parameters = tuple(ParameterSpec(**p) for p in entry["parameters"])
        kind = "threshold" if entry["threshold"] else "smooth"
        specs.append(EffectSpec(entry["name"], entry["summary"], kind, entry["site"], parameters))
    return specs


# Effects that change the fields of the material, not the equations of motion.
_MATERIAL = (
    EffectSpec(
        "compressibility",
        "Poisson's ratio differs from the assumed one",
        "smooth",
        "material",
        (ParameterSpec("nu", "-", 0.3, 0.0, 0.495, 0.05),),
    ),
    EffectSpec(
        "stiffness_gradient",
        "Young's modulus of one part times exp(slope (X - centroid).axis)",
        "smooth",
        "material",
        (ParameterSpec("slope", "1/m", 0.0, -1000.0, 1000.0, 10.0),),
    ),
    EffectSpec(
        "density_gradient",
        "density of one part times exp(slope (X - centroid).axis)",
        "smooth",
        "material",
        (ParameterSpec("slope", "1/m", 0.0, -1000.0, 1000.0, 10.0),),
    ),
)

# Faults of the measurement: they act on what is seen of the simulation, and when.
_MEASUREMENT = (
    EffectSpec(
        "time_offset",
        "frame k shows the state at k/fps + offset",
        "measurement",
        "measurement",
        (ParameterSpec("offset", "s", 0.0, -1.0, 1.0, 0.01),),
    ),
    EffectSpec(
        "length_scale",
        "measured lengths are true ones times 1 + scale",
        "measurement",
        "measurement",
        (ParameterSpec("scale", "-", 0.0, -0.5, 0.5, 0.01),),
    ),
    EffectSpec(
        "frame_drift",
        "rigid motion of the measuring frame",
        "measurement",
        "measurement",
        tuple(ParameterSpec(f"v_{a}", "m/s", 0.0, -1.0, 1.0, 1e-3) for a in "xyz")
        + tuple(ParameterSpec(f"w_{a}", "rad/s", 0.0, -1.0, 1.0, 1e-2) for a in "xyz"),
    ),
    EffectSpec(
        "marker_outliers",
        "some markers do not follow the object",
        "measurement",
        "measurement",
        (ParameterSpec("count", "-", 0.0, 0.0, 1e6, 1.0, fitted=False),),
    ),
)

_USER: dict[str, EffectSpec] = {}


@cache
def _built_in() -> dict[str, EffectSpec]:
    return {spec.name: spec for spec in (*_core_effects(), *_MATERIAL, *_MEASUREMENT)}


def effects() -> dict[str, EffectSpec]:
    """All known effects by name."""
    return {**_built_in(), **_USER}


def effect(name: str) -> EffectSpec:
    """The effect called `name`. Raises KeyError, naming those there are."""
    known = effects()
    if name not in known:
        raise KeyError(f"unknown effect '{name}'; expected one of {', '.join(sorted(known))}")
    return known[name]


def register(spec: EffectSpec) -> None:
    """Add a user's own effect. Raises ValueError when the name is taken by a built-in one."""
    if spec.name in _built_in():
        raise ValueError(f"effect '{spec.name}': the name is taken by a built-in effect")
    _USER[spec.name] = spec


@cache
def core_parameter_offsets() -> dict[str, int]:
    """First index of every core effect's parameters in the flat array of the core."""
    offsets, next_index = {}, 0
    for spec in _core_effects():
        offsets[spec.name] = next_index
        next_index += len(spec.parameters)
    return offsets


@cache
def core_parameter_nulls() -> tuple[float, ...]:
    """Null values of all core parameters, in the order of the flat array."""
    return tuple(p.null for spec in _core_effects() for p in spec.parameters)


@cache
def point_parameter_offsets() -> tuple[dict[str, int], int]:
    """Offsets of the effects that act at a place within one place's parameters, and their number."""
    offsets, next_index = {}, 0
    for spec in _core_effects():
        if spec.site == "point":
            offsets[spec.name] = next_index
            next_index += len(spec.parameters)
    return offsets, next_index
