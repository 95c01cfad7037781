"""Causes of motion outside the list of effects: forces that no name of the registry stands for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

# Force (Q, 3) [N] and first Piola-Kirchhoff stress (Q, 3, 3) [Pa], None where there is none.
Forces = tuple[np.ndarray | None, np.ndarray | None]


@dataclass(frozen=True, eq=False)
class MaterialState:
    """State of all quadrature points at one time.

    reference, position [m], velocity [m/s]: (Q, 3); deformation: (Q, 3, 3); mass [kg], volume [m^3]: (Q,);
    inside: (Q,) bool, the points that the cause acts on; time: [s].
    """

    reference: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    deformation: np.ndarray
    mass: np.ndarray
    volume: np.ndarray
    inside: np.ndarray
    time: float


def cubic_drag(material: MaterialState, values: Mapping[str, float]) -> Forces:
    """Force -c_3 |v|^2 v per mass; c_3 [s/m^2]."""
    speed = (material.velocity**2).sum(1)
    force = -values["c_3"] * (material.mass * material.inside * speed)[:, None] * material.velocity
    return force, None


def point_field(material: MaterialState, values: Mapping[str, float]) -> Forces:
    """Pull towards a fixed point (x, y, z) [m], strength / d^2 per mass; strength [m^3/s^2].

    Within `core` [m] of the point the pull stays finite.
    """
    towards = np.array([values["x"], values["y"], values["z"]]) - material.position
    distance = np.sqrt((towards**2).sum(1) + values["core"] ** 2)
    share = values["strength"] * material.mass * material.inside / distance**3
    return share[:, None] * towards, None


def actuation(material: MaterialState, values: Mapping[str, float]) -> Forces:
    """A muscle along (a_x, a_y, a_z) on one side of its points: second Piola-Kirchhoff stress, amplitude [Pa]
    times sin(2 pi f t), growing linearly across (b_x, b_y, b_z) over their extent, so that it bends them."""
    fibre, across = (np.array([values[f"{k}_{c}"] for c in "xyz"]) for k in "ab")
    place = material.reference @ across
    middle = np.average(place, weights=material.volume * material.inside)
    arm = (place - middle) / np.abs(place - middle)[material.inside].max()
    tension = values["amplitude"] * np.sin(2.0 * np.pi * values["f"] * material.time) * arm * material.inside
    stress = np.einsum("q,qik,k,j->qij", tension, material.deformation, fibre, fibre)
    return None, stress


@dataclass(frozen=True)
class Cause:
    """function(material, values) gives the forces; values: names of its numbers."""

    name: str
    function: Callable[[MaterialState, Mapping[str, float]], Forces]
    values: tuple[str, ...]


CAUSES: Mapping[str, Cause] = {
    cause.name: cause
    for cause in (
        Cause("cubic_drag", cubic_drag, ("c_3",)),
        Cause("point_field", point_field, ("strength", "x", "y", "z", "core")),
        Cause("actuation", actuation, ("amplitude", "f", "a_x", "a_y", "a_z", "b_x", "b_y", "b_z")),
    )
}
