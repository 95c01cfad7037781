"""The effects that can be named: those of the core, other laws, those of the measurement, the user's own.

One table that the command line, diagnosis, reports and tests read. Names, units and null values are
those of the public list of effects.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import TypeVar

from mphygs import _core
from mphygs.model import faults as fault_files
from mphygs.model import material_effects as material_files
from mphygs.model.descriptor import EffectSpec, ParameterSpec
from mphygs.model.fault import Fault
from mphygs.model.material_effect import MaterialEffect

__all__ = [
    "USUAL_LAW", "EffectSpec", "ParameterSpec", "core_parameter_nulls", "core_parameter_offsets", "effect",
    "effects", "faults", "laws", "material_effects", "outliers", "point_parameter_offsets", "add_user_effect",
]  # fmt: skip

Kind = TypeVar("Kind", Fault, MaterialEffect)


@cache
def _core_effects() -> tuple[EffectSpec, ...]:
    specs = []
    for entry in _core.effects():
        known = dict(entry)
        known["parameters"] = tuple(ParameterSpec(**p) for p in known["parameters"])
        known["kind"] = "threshold" if known.pop("threshold") else "smooth"
        known["settings"] = ("place",) if known["site"] in ("point", "mass") else ()
        specs.append(EffectSpec(**known))
    return tuple(specs)


def _found(folder: ModuleType, kind: type[Kind]) -> tuple[Kind, ...]:
    """One of each class of a kind that the files of a folder define, in the order in which they act."""
    classes = []
    for file in sorted(m.name for m in iter_modules(folder.__path__)):
        module = import_module(f"{folder.__name__}.{file}")
        own = (c for c in vars(module).values() if isinstance(c, type) and c.__module__ == module.__name__)
        classes += [c for c in own if issubclass(c, kind)]
    return tuple(sorted((c() for c in classes), key=lambda e: e.order))


@cache
def faults() -> tuple[Fault, ...]:
    """All faults of the measurement, in the order in which they act on what the simulation says."""
    return _found(fault_files, Fault)


@cache
def material_effects() -> tuple[MaterialEffect, ...]:
    """All effects that change the material, in the order in which they do."""
    return _found(material_files, MaterialEffect)


def laws() -> tuple[str, ...]:
    """Names of the elastic laws of this build, the usual one first."""
    known = _core.laws()
    return tuple(law["name"] for law in sorted(known, key=lambda law: not law["usual"]))


USUAL_LAW = laws()[0]

_USER: dict[str, EffectSpec] = {}


@cache
def _built_in() -> dict[str, EffectSpec]:
    material = (
        EffectSpec(
            e.name, e.summary, "smooth", "material", e.parameters, settings=e.settings, replaces=e.replaces
        )
        for e in material_effects()
    )
    measurement = (
        EffectSpec(
            e.name, e.summary, "measurement", "measurement", e.parameters, leaves_out=e.leaves_out
        )
        for e in faults()
    )
    known = {spec.name: spec for spec in (*_core_effects(), *material, *measurement)}
    for name in laws():
        if name in known:
            raise ValueError(f"law '{name}': the name is taken by an effect; expected one of its own")
        known[name] = EffectSpec(name, f"the elastic law {name} in the place of another", "smooth", "law")
    return known


def effects() -> dict[str, EffectSpec]:
    """All known effects by name."""
    return {**_built_in(), **_USER}


def effect(name: str) -> EffectSpec:
    """The effect called `name`. Raises KeyError, naming those there are."""
    known = effects()
    if name not in known:
        raise KeyError(f"unknown effect '{name}'; expected one of {', '.join(sorted(known))}")
    return known[name]


def outliers() -> str:
    """Name of the fault for which measurements are left out."""
    (name,) = (spec.name for spec in _built_in().values() if spec.leaves_out)
    return name


def add_user_effect(spec: EffectSpec) -> None:
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
