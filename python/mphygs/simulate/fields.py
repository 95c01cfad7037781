"""From a belief to the arrays of the core, and their derivative by each parameter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mphygs.model.belief import Belief, Parameter
from mphygs.model.materials import lame, lame_by_poissons_ratio
from mphygs.model.registry import (
    core_parameter_nulls,
    core_parameter_offsets,
    effect,
    point_parameter_offsets,
)
from mphygs.simulate.body import LANES, Body

# Effects that load the object at rest as well, where its rest shape is an equilibrium.
STATIC_EFFECTS = ("gravity", "attached_mass", "tether", "wind")
# Effects that make a material differ from place to place.
GRADIENTS = ("stiffness_gradient", "density_gradient")


@dataclass(frozen=True, eq=False)
class PointFields:
    """Material at every quadrature point, (B, 8): E [Pa], nu [-], density [kg/m^3]."""

    youngs_modulus: np.ndarray
    poissons_ratio: np.ndarray
    density: np.ndarray


def _gradient_arm(belief: Belief, body: Body, name: str) -> np.ndarray:
    """(X - centroid).axis in the part of a gradient effect, zero elsewhere, (B, 8) [m]."""
    settings = belief.term(name).settings
    part = body.part_names.index(str(settings["part"]))
    axis = np.asarray(settings["axis"], float)
    arm = (body.quadrature.points - body.centroid[part]) @ (axis / np.linalg.norm(axis))
    return np.where(body.quadrature.part[:, None] == part, arm, 0.0)


def point_fields(belief: Belief, body: Body) -> PointFields:
    """The material of every point."""
    part = body.point_part

    def by_part(quantity: str) -> np.ndarray:
        return np.array([belief[f"{name}.{quantity}"].value for name in body.part_names])[part]

    youngs_modulus, density = by_part("youngs_modulus"), by_part("density")
    poissons_ratio = by_part("poissons_ratio")
    if "compressibility" in belief.effects:
        poissons_ratio = np.full(part.shape, belief["compressibility.nu"].value)
    if "stiffness_gradient" in belief.effects:
        slope = belief["stiffness_gradient.slope"].value
        youngs_modulus = youngs_modulus * np.exp(slope * _gradient_arm(belief, body, "stiffness_gradient"))
    if "density_gradient" in belief.effects:
        slope = belief["density_gradient.slope"].value
        density = density * np.exp(slope * _gradient_arm(belief, body, "density_gradient"))
    return PointFields(youngs_modulus, poissons_ratio, density)


def core_effects(belief: Belief) -> tuple[str, ...]:
    """Names of the belief's effects that the compiled core computes."""
    names = [t.name for t in belief.terms if effect(t.name).site not in ("material", "measurement", "user")]
    if belief.prestress == "paper":
        names.append("prestress")
    return tuple(names)


def places(belief: Belief) -> np.ndarray:
    """(K, 3) places of the effects that have one, in the order of the terms [m]."""
    return np.array([t.settings["place"] for t in belief.terms if "place" in t.settings], float).reshape(
        -1, 3
    )


def _place_index(belief: Belief, name: str) -> int:
    return [t.name for t in belief.terms if "place" in t.settings].index(name)


def primal(belief: Belief, body: Body) -> dict[str, np.ndarray]:
    """All fields of the core but poses and forces, float64, without prestress."""
    material = point_fields(belief, body)
    mu, lam = lame(material.youngs_modulus, material.poissons_ratio)
    effects = np.array(core_parameter_nulls())
    offsets = core_parameter_offsets()
    place_offsets, place_count = point_parameter_offsets()
    count = len(places(belief))
    place_mass, place_effect = np.zeros(count), np.zeros((count, place_count))
    for term in belief.terms:
        spec = effect(term.name)
        for k, p in enumerate(spec.parameters):
            value = belief[f"{term.name}.{p.name}"].value
            if spec.site == "mass":
                place_mass[_place_index(belief, term.name)] = value
            elif spec.site == "point":
                place_effect[_place_index(belief, term.name), place_offsets[term.name] + k] = value
            elif spec.site not in ("material", "measurement", "user"):
                effects[offsets[term.name] + k] = value
    if "contact" in belief.effects and belief["contact.stiffness"].value == 0.0:
        # As stiff as a cell of the softest part: it sinks in by micrometres where flowers touch. Ten times as
        # stiff, the material bounces from substep to substep and no derivative is left. Rounded, so that it
        # is constant while Young's moduli are fitted.
        stiffness = material.youngs_modulus.min() / body.quadrature.spacing.min()
        effects[offsets["contact"] + 5] = 2.0 ** np.round(np.log2(stiffness))
    if belief.prestress == "paper":
        carried = np.array(belief.gravity, float)
        if "gravity" in belief.effects:
            carried = carried + [belief[f"gravity.delta_g_{a}"].value for a in "xyz"]
        effects[offsets["prestress"] : offsets["prestress"] + 3] = body.towards(carried)
    if "gravity" in belief.effects:
        own = slice(offsets["gravity"], offsets["gravity"] + 3)
        effects[own] = body.towards(effects[own])
    return {
        "mu": mu,
        "lambda": lam,
        "stress_volume": body.quadrature.volumes,
        "mass": material.density * body.quadrature.volumes,
        "effect": effects,
        "place_mass": place_mass,
        "place_effect": place_effect,
        "gravity": body.towards(belief.gravity),
    }


def direction(belief: Belief, body: Body, parameter: Parameter) -> dict[str, np.ndarray]:
    """Derivative of `primal` by a parameter's coordinate; absent entries are zero.

    Raises KeyError for a parameter that does not act through the simulation.
    """
    owner, quantity = parameter.key.rsplit(".", 1)
    material = point_fields(belief, body)
    mu, lam = lame(material.youngs_modulus, material.poissons_ratio)
    mass = material.density * body.quadrature.volumes
    if owner in body.part_names:
        mask = body.point_part == body.part_names.index(owner)
        relative = parameter.slope / parameter.value if parameter.value else 0.0
        if quantity == "youngs_modulus":
            return {"mu": mu * mask * relative, "lambda": lam * mask * relative}
        if quantity == "density":
            return {"mass": mass * mask * relative}
        if quantity == "poissons_ratio":
            d_mu, d_lam = lame_by_poissons_ratio(material.youngs_modulus, material.poissons_ratio)
            return {"mu": d_mu * mask * parameter.slope, "lambda": d_lam * mask * parameter.slope}
        raise KeyError(parameter.key)
    spec = effect(owner)
    if owner == "compressibility":
        d_mu, d_lam = lame_by_poissons_ratio(material.youngs_modulus, material.poissons_ratio)
        return {"mu": d_mu * parameter.slope, "lambda": d_lam * parameter.slope}
    if owner == "stiffness_gradient":
        arm = _gradient_arm(belief, body, owner) * parameter.slope
        return {"mu": mu * arm, "lambda": lam * arm}
    if owner == "density_gradient":
        return {"mass": mass * _gradient_arm(belief, body, owner) * parameter.slope}
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
    if spec.site == "measurement":
        raise KeyError(parameter.key)
    out = np.zeros(len(core_parameter_nulls()))
    first = core_parameter_offsets()
    if owner == "gravity":
        moved = parameter.slope * body.towards(np.eye(3)[index])
        for name in ("gravity", "prestress") if belief.prestress == "paper" else ("gravity",):
            out[first[name] : first[name] + 3] = moved
    else:
        out[first[owner] + index] = parameter.slope
    return {"effect": out}


def at_rest(belief: Belief) -> Belief:
    """What of the belief loads the published rest shape: statics only.

    An effect whose term says `at_rest: False` came after the shape was taken.
    """
    terms = tuple(
        t for t in belief.terms if not (t.name in STATIC_EFFECTS and not t.settings.get("at_rest", True))
    )
    return replace(belief, terms=terms)


def pad(values: np.ndarray) -> np.ndarray:
    """(B, 8) of per-block numbers (B,)."""
    return np.repeat(np.asarray(values, float)[:, None], LANES, axis=1)
