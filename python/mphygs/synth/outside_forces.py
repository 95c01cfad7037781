"""Forces on the points of an independent simulator that come from outside the material."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

Values = Mapping[str, float]
AIR_DENSITY = 1.2  # [kg/m^3]


def body_field(gravity: np.ndarray, v: np.ndarray, time: float, effects: Mapping[str, Values]) -> np.ndarray:
    """Acceleration [m/s^2] by weight and body effects at points of velocity v, (3,) or (N, 3) [m/s]."""
    field = np.broadcast_to(gravity, v.shape)
    if "gravity" in effects:
        field = field + np.array([effects["gravity"][f"delta_g_{a}"] for a in "xyz"])
    if "base_motion" in effects:
        values = effects["base_motion"]
        angle = 2.0 * math.pi * values["f"] * time + values["phase"]
        wave = math.sin(angle)
        if not 0.0 <= angle <= math.pi:
            wave *= 1.0 - values["pulse"]
        field = field - wave * np.array([values[f"a_{a}"] for a in "xyz"])
    if "mass_damping" in effects:
        field = field - effects["mass_damping"]["alpha"] * v
    return field


def drag(v: np.ndarray, area: np.ndarray, effects: Mapping[str, Values]) -> np.ndarray | float:
    """(N, 3) [N] of air, still and moved, on areas (N,) [m^2] of velocity v (N, 3) [m/s]; 0 without."""
    force: np.ndarray | float = 0.0
    for name in ("air_drag", "wind"):
        if name in effects:
            values = effects[name]
            flow = np.array([values.get(f"w_{a}", 0.0) for a in "xyz"])
            against = v - flow
            speed = np.linalg.norm(against, axis=1, keepdims=True)
            force = force - 0.5 * AIR_DENSITY * values["c_d"] * area[:, None] * speed * against
    return force


def tether(x: np.ndarray, values: Values) -> np.ndarray:
    """(1, 3) [N] on a place x (1, 3) [m]."""
    anchor = np.array([values[f"anchor_{a}"] for a in "xyz"])
    return -values["k"] * (x - anchor)
