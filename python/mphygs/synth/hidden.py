"""What may be hidden in a capture: effects of the registry, faults of measurement, causes outside both."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mphygs.model.descriptor import EffectSpec
from mphygs.model.registry import USUAL_LAW, effects
from mphygs.synth.causes import CAUSES
from mphygs.synth.faults import DEFAULTS as FAULTS
from mphygs.synth.faults import fault_values
from mphygs.synth.shape import Shape

# Viscosity over Young's modulus of what is thin [s]: of rubber and soft plastics, 2 % of critical at 4 Hz.
THIN_DECAY = 8e-4
SETTINGS = ("place", "part", "axis", "at_rest")


@dataclass(frozen=True)
class Hidden:
    """One hidden thing. kind: "effect", "fault" or "cause"; values: parameter -> number in its unit;
    settings: as of a model's term (place, part, axis, at_rest)."""

    name: str
    kind: str
    values: Mapping[str, float] = field(default_factory=dict)
    settings: Mapping[str, object] = field(default_factory=dict)

    @property
    def at_rest(self) -> bool:
        """Whether it is an effect that loads the object at rest as well."""
        loads = self.kind == "effect" and effects()[self.name].loads_at_rest
        return loads and bool(self.settings.get("at_rest", True))


def hidden_names() -> tuple[str, ...]:
    """Everything that can be hidden, by name."""
    never = {USUAL_LAW, *(n for n, spec in effects().items() if spec.fault or spec.carries_gravity)}
    return (
        *(n for n in effects() if n not in never),
        *FAULTS,
        *CAUSES,
    )


def parse(text: str, shape: Shape, mass: float, youngs_modulus: float) -> Hidden:
    """`name` or `name:key=value:key=value`; a value is a number, a word, or numbers with / between them.

    mass: of the object [kg]; youngs_modulus: of its stiffest part [Pa]: what is not given is taken so that
    the effect shows on an object like this. Raises ValueError for unknown names and keys.
    """
    name, *pairs = text.split(":")
    given: dict[str, object] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not equals:
            raise ValueError(f"hidden '{text}': '{pair}' is not key=value")
        given[key] = _value(value)
    return hidden(name, shape, mass, youngs_modulus, given)


def hidden(
    name: str, shape: Shape, mass: float, youngs_modulus: float, given: Mapping[str, object]
) -> Hidden:
    """The hidden thing called `name` with the given numbers and settings, the usual ones for the rest."""
    if name not in hidden_names():
        raise ValueError(f"hidden effect '{name}': expected one of {', '.join(hidden_names())}")
    settings = {k: v for k, v in given.items() if k in SETTINGS}
    values = {k: v for k, v in given.items() if k not in SETTINGS}
    for key, value in values.items():
        if not isinstance(value, float):
            raise ValueError(f"hidden effect '{name}': {key} = {value}, expected a number")
    if settings.get("part", shape.part_names[0]) not in shape.part_names:
        raise ValueError(
            f"hidden effect '{name}': part '{settings['part']}', expected {' or '.join(shape.part_names)}"
        )
    if name in FAULTS:
        if settings:
            raise ValueError(f"fault '{name}' has no {', '.join(settings)}")
        return Hidden(name, "fault", fault_values(name, values))
    usual_values, usual_settings = _usual(name, shape, mass, youngs_modulus)
    known = CAUSES[name].values if name in CAUSES else tuple(p.name for p in effects()[name].parameters)
    for key in values:
        if key not in known:
            raise ValueError(f"hidden effect '{name}' has no '{key}', expected one of {', '.join(known)}")
    if name in CAUSES:
        return Hidden(
            name,
            "cause",
            {k: float(values.get(k, usual_values[k])) for k in known},
            usual_settings | settings,
        )
    null = {p.name: p.null for p in effects()[name].parameters}
    return Hidden(name, "effect", null | usual_values | values, usual_settings | settings)


def _value(text: str) -> object:
    parts = text.split("/")
    try:
        numbers = tuple(float(p) for p in parts)
    except ValueError:
        if text in ("true", "false"):
            return text == "true"
        return text
    return numbers[0] if len(numbers) == 1 else numbers


def _across(shape: Shape) -> np.ndarray:
    """A unit vector across the object's long axis, and across gravity where both allow that."""
    across = np.cross(shape.axis, shape.gravity)
    if np.linalg.norm(across) < 1e-9:
        across = np.array([1.0, 0.0, 0.0])
    return across / np.linalg.norm(across)


def _usual(
    name: str, shape: Shape, mass: float, youngs_modulus: float
) -> tuple[dict[str, float], dict[str, object]]:
    """Values and settings that make an effect show, by some sigma of usual noise, on this object."""
    across, first = _across(shape), shape.part_names[0]
    tip, length = shape.tip, float((shape.tip - shape.pivot) @ shape.axis)

    def vector(prefix: str, v: np.ndarray) -> dict[str, float]:
        return {f"{prefix}_{c}": float(x) for c, x in zip("xyz", v, strict=True)}

    at_tip = {"place": tuple(tip)}
    along_first = {"part": first, "axis": tuple(shape.axis)}
    # A wall beside the object, or, for one that lies across gravity, a floor below it.
    lying = abs(shape.axis @ shape.gravity) < 1e-9
    normal = -shape.gravity / np.linalg.norm(shape.gravity) if lying else -across
    beside = min(float((part.vertices @ normal).min()) for part in shape.parts)
    table: dict[str, tuple[dict[str, float], dict[str, object]]] = {
        "gravity": (vector("delta_g", 1.0 * across), {}),
        "viscosity": ({"eta": THIN_DECAY * youngs_modulus if shape.lines or shape.sheet else 80.0}, {}),
        "mass_damping": ({"alpha": 1.5}, {}),
        "relaxation": ({"ratio": 0.5, "tau": 0.1}, {}),
        "air_drag": ({"c_d": 6.0}, {}),
        "wind": (vector("w", 3.0 * across) | {"c_d": 1.5}, {"at_rest": False}),
        "fibre": ({"k_f": 0.5 * youngs_modulus} | vector("a", shape.axis), {}),
        "stiffening": ({"c_2": 20.0 * youngs_modulus}, {}),
        "compressibility": ({"nu": 0.47}, {}),
        "plasticity": ({"yield_stress": 0.03 * youngs_modulus}, {}),
        "contact": ({"d": beside - 0.05 * length, "mu": 0.2} | vector("n", normal), {}),
        "attached_mass": ({"m": 0.1 * mass}, at_tip),
        "hold_compliance": ({"compliance": 5e-3}, {}),
        "tether": ({"k": 0.5} | vector("anchor", tip + 0.02 * across), at_tip | {"at_rest": False}),
        "eigenstrain": ({"rate": 0.02}, {}),
        "base_motion": (vector("a", 2.0 * across) | {"f": 2.3}, {}),
        "stiffness_gradient": ({"slope": 0.8 / length}, along_first),
        "density_gradient": ({"slope": 2.4 / length}, along_first),
        "cubic_drag": ({"c_3": 80.0}, {"part": shape.part_names[min(1, len(shape.parts) - 1)]}),
        "point_field": (
            {"strength": 6e-3, "core": 0.02} | dict(zip("xyz", tip + 0.05 * across, strict=True)),
            {},
        ),
        "actuation": (
            {"amplitude": 0.02 * youngs_modulus, "f": 1.9} | vector("a", shape.axis) | vector("b", across),
            {"part": first},
        ),
    }
    values, settings = table.get(name) or _described(effects()[name], shape)
    return {k: float(v) for k, v in values.items()}, settings


def _described(spec: EffectSpec, shape: Shape) -> tuple[dict[str, float], dict[str, object]]:
    """Values and settings of an effect that is not in the table, as its descriptor suggests."""
    vectors = {
        "direction": shape.axis,
        "axis": shape.axis,
        "flow": _across(shape),
        "anchor": shape.tip,
    }
    values = {p.name: p.null + p.scale for p in spec.of_role("strength")}
    values |= {p.name: math.sqrt(p.range[0] * p.range[1]) for p in spec.of_role("level")}
    for role, vector in vectors.items():
        values |= {p.name: v for p, v in zip(spec.of_role(role), vector, strict=False)}
    settings = {"place": tuple(shape.tip), "part": shape.part_names[0], "axis": tuple(shape.axis)}
    return values, {key: settings[key] for key in spec.settings}
