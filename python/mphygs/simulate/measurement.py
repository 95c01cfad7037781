"""Faults of the measurement: what they make of the simulated markers, forwards and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.model.belief import Belief, Parameter


def measured(
    belief: Belief,
    wanted: Sequence[tuple[Belief, Parameter]],
    times: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    jacobian: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faults of the measurement, applied to what the simulation says.

    A late clock has its part already: the simulation shows the frames when they were taken. times: (T,) that
    the measurement states [s]; position, velocity: (T, M, 3); jacobian: (T, M, 3, K) by the wanted
    parameters, whose columns of faults are filled in place.
    """
    t = times[:, None, None]
    for slot, (_, parameter) in enumerate(wanted):
        owner, _, quantity = parameter.key.rpartition(".")
        if owner == "time_offset":
            jacobian[..., slot] = velocity * parameter.slope
        elif owner == "length_scale":
            jacobian[..., slot] = position * parameter.slope
        elif owner == "frame_drift":
            axis = np.eye(3)["xyz".index(quantity[-1])]
            moved = np.broadcast_to(axis, position.shape) if quantity[0] == "v" else np.cross(axis, position)
            jacobian[..., slot] = t * moved * parameter.slope
    if "frame_drift" in belief.effects:
        v = np.array([belief[f"frame_drift.v_{a}"].value for a in "xyz"])
        w = np.array([belief[f"frame_drift.w_{a}"].value for a in "xyz"])
        position = position + t * (v + np.cross(w, position))
    if "length_scale" in belief.effects:
        factor = 1.0 + belief["length_scale.scale"].value
        position, velocity = position * factor, velocity * factor
        jacobian = jacobian * factor
    return position, velocity, jacobian


def before_measurement(belief: Belief, times: np.ndarray, bar: np.ndarray) -> np.ndarray:
    """Bar of the simulated positions, (T, M, 3), for the bar of what the measurement shows."""
    if "length_scale" in belief.effects:
        bar = bar * (1.0 + belief["length_scale.scale"].value)
    if "frame_drift" in belief.effects:
        turn = np.array([belief[f"frame_drift.w_{a}"].value for a in "xyz"])
        bar = bar + times[:, None, None] * np.cross(bar, turn)
    return bar
