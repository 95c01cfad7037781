"""From a belief to the arrays of the core, and their derivative by each parameter."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mphygs import _core
from mphygs.model.belief import Belief, Parameter
from mphygs.model.material_effect import MaterialChange, PointFields
from mphygs.model.materials import lame, lame_by_poissons_ratio
from mphygs.model.registry import (
    core_parameter_nulls,
    core_parameter_offsets,
    effect,
    effects,
    material_effects,
    point_parameter_offsets,
)
from mphygs.simulate.body import LANES, Body
from mphygs.simulate.section import POWERS, QUANTITY, section_factors


def point_fields(belief: Belief, body: Body) -> PointFields:
    """The material of every point."""
    part = body.point_part

    def by_part(quantity: str) -> np.ndarray:
        return np.array([belief[f"{name}.{quantity}"].value for name in body.part_names])[part]

    factors = np.ones((len(body.part_names), 2))
    for number, own in enumerate(body.parts):
        factors[number] = section_factors(belief, own)
    material = PointFields(
        by_part("youngs_modulus") * factors[part, 0],
        by_part("poissons_ratio"),
        by_part("density") * factors[part, 1],
    )
    for own in material_effects():
        if own.name in belief.effects:
            settings = belief.term(own.name).settings
            material = own.changed(material, belief.values_of(own.name), settings, body)
    return material


def gravity_of(belief: Belief, body: Body) -> np.ndarray:
    """(3,) gravity that a belief has act, corrections of it included, in the sequence's frame [m/s^2]."""
    acting = np.array(belief.gravity, float)
    for term in belief.terms:
        if effect(term.name).corrects_gravity:
            acting = acting + np.array(list(belief.values_of(term.name).values()))
    return body.towards(acting)


def core_effects(belief: Belief) -> tuple[str, ...]:
    """Names of the belief's effects that the compiled core computes."""
    names = [t.name for t in belief.terms if effect(t.name).in_core]
    if belief.prestress == "paper":
        names += [name for name, spec in effects().items() if spec.carries_gravity]
    return tuple(names)


def places(belief: Belief) -> np.ndarray:
    """(K, 3) places of the effects that have one, in the order of the terms [m]."""
    return np.array([t.settings["place"] for t in belief.terms if "place" in t.settings], float).reshape(
        -1, 3
    )


def _place_index(belief: Belief, name: str) -> int:
    return [t.name for t in belief.terms if "place" in t.settings].index(name)


def core_inputs(belief: Belief, body: Body) -> dict[str, np.ndarray]:
    """All fields of the core but poses and forces, float64, without prestress."""
    material = point_fields(belief, body)
    mu, lam = lame(material.youngs_modulus, material.poissons_ratio)
    place_offsets, place_count = point_parameter_offsets()
    count = len(places(belief))
    place_mass, place_effect = np.zeros(count), np.zeros((count, place_count))
    for term in belief.terms:
        spec = effect(term.name)
        values = list(belief.values_of(term.name).values())
        if spec.site == "mass":
            place_mass[_place_index(belief, term.name)] = values[0]
        elif spec.site == "point":
            first = place_offsets[term.name]
            place_effect[_place_index(belief, term.name), first : first + len(values)] = values
    return {
        "mu": mu,
        "lambda": lam,
        "stress_volume": body.quadrature.volumes,
        "mass": material.density * body.quadrature.volumes,
        "effect": _effect_numbers(belief, body, material),
        "place_mass": place_mass,
        "place_effect": place_effect,
        "gravity": body.towards(belief.gravity),
    }


def _effect_numbers(belief: Belief, body: Body, material: PointFields) -> np.ndarray:
    """The numbers of all core effects that have no place, in the order of the flat array."""
    numbers, offsets = np.array(core_parameter_nulls()), core_parameter_offsets()
    active = core_effects(belief)
    carried = np.array(belief.gravity, float)
    for name in active:
        spec = effect(name)
        if spec.placed or spec.carries_gravity:
            continue
        values = np.array(list(belief.values_of(name).values()))
        if spec.corrects_gravity:
            carried = carried + values
            values = body.towards(values)
        numbers[offsets[name] : offsets[name] + len(values)] = values
    for name in active:
        if effect(name).carries_gravity:
            numbers[offsets[name] : offsets[name] + 3] = body.towards(carried)
    return _core.complete(numbers, list(active), material.youngs_modulus.min(), body.quadrature.spacing.min())


def core_input_tangent(belief: Belief, body: Body, parameter: Parameter) -> dict[str, np.ndarray]:
    """Derivative of `core_inputs` by a parameter's coordinate; absent entries are zero.

    Raises KeyError for a parameter that does not act through the simulation.
    """
    owner, quantity = parameter.key.rsplit(".", 1)
    if owner in body.part_names:
        mask = body.point_part == body.part_names.index(owner)
        relative = parameter.slope / parameter.value if parameter.value else 0.0
        if quantity == "youngs_modulus":
            return _through_material(belief, body, MaterialChange(youngs_modulus=mask), relative)
        if quantity == "density":
            return _through_material(belief, body, MaterialChange(density=mask), relative)
        if quantity == "poissons_ratio":
            return _through_material(belief, body, MaterialChange(poissons_ratio=mask), parameter.slope)
        if quantity == QUANTITY:
            of_modulus, of_density = POWERS[body.parts[body.part_names.index(owner)].shape]
            change = MaterialChange(youngs_modulus=of_modulus * mask, density=of_density * mask)
            return _through_material(belief, body, change, relative)
        raise KeyError(parameter.key)
    spec = effect(owner)
    for own in material_effects():
        if own.name == owner:
            settings = belief.term(owner).settings
            change = own.derivative(quantity, belief.values_of(owner), settings, body)
            return _through_material(belief, body, change, parameter.slope)
    index = [p.name for p in spec.parameters].index(quantity)
    if spec.site == "mass":
        out = np.zeros(len(places(belief)))
        out[_place_index(belief, owner)] = parameter.slope
        return {"place_mass": out}
    if spec.site == "point":
        place_offsets, place_count = point_parameter_offsets()
        out = np.zeros((len(places(belief)), place_count))
        out[_place_index(belief, owner), place_offsets[owner] + index] = parameter.slope
        return {"place_effect": out}
    if spec.site == "user":
        return {}  # the hook carries it
    if spec.fault:
        raise KeyError(parameter.key)
    out = np.zeros(len(core_parameter_nulls()))
    first = core_parameter_offsets()
    if spec.corrects_gravity:
        moved = parameter.slope * body.towards(np.eye(3)[index])
        carriers = (name for name in core_effects(belief) if effect(name).carries_gravity)
        for name in (owner, *carriers):
            out[first[name] : first[name] + 3] = moved
    else:
        out[first[owner] + index] = parameter.slope
    return {"effect": out}


def _through_material(
    belief: Belief, body: Body, change: MaterialChange, slope: float
) -> dict[str, np.ndarray]:
    """Derivative of `core_inputs` by what changes the material, slope times."""
    material, out = point_fields(belief, body), {}
    if change.youngs_modulus is not None:
        mu, lam = lame(material.youngs_modulus, material.poissons_ratio)
        stiffer = change.youngs_modulus * slope
        out = {"mu": mu * stiffer, "lambda": lam * stiffer}
    if change.poissons_ratio is not None:
        by_ratio = lame_by_poissons_ratio(material.youngs_modulus, material.poissons_ratio)
        for name, derivative in zip(("mu", "lambda"), by_ratio, strict=True):
            out[name] = out.get(name, 0.0) + derivative * change.poissons_ratio * slope
    if change.density is not None:
        out["mass"] = material.density * body.quadrature.volumes * change.density * slope
    return out


def at_rest(belief: Belief) -> Belief:
    """What of the belief loads the published rest shape: statics only.

    An effect whose term says `at_rest: False` came after the shape was taken.
    """
    terms = tuple(
        t for t in belief.terms if t.settings.get("at_rest", True) or not effect(t.name).loads_at_rest
    )
    return replace(belief, terms=terms)


def pad(values: np.ndarray) -> np.ndarray:
    """(B, 8) of per-block numbers (B,)."""
    return np.repeat(np.asarray(values, float)[:, None], LANES, axis=1)
