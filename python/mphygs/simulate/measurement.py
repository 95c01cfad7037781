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

    times: (T,) [s]; position, velocity: (T, M, 3); jacobian: (T, M, 3, K) by the wanted parameters, whose
    columns of faults are filled in place.
    """
    if "time_offset" in belief.effects:
        position, velocity = _shifted(times, position, velocity, belief["time_offset.offset"].value)
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


def _shifted(
    times: np.ndarray, position: np.ndarray, velocity: np.ndarray, shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """State at times + shift, by the cubic through positions and velocities of the frames."""
    if len(times) < 2:
        return position, velocity
    at = np.clip(times + shift, times[0], times[-1])
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    span = (times[k + 1] - times[k])[:, None, None]
    s = ((at - times[k])[:, None, None]) / span
    p0, p1, v0, v1 = position[k], position[k + 1], velocity[k] * span, velocity[k + 1] * span
    cubic = p0 + s * v0 + s**2 * (3 * (p1 - p0) - 2 * v0 - v1) + s**3 * (2 * (p0 - p1) + v0 + v1)
    slope = (v0 + 2 * s * (3 * (p1 - p0) - 2 * v0 - v1) + 3 * s**2 * (2 * (p0 - p1) + v0 + v1)) / span
    return cubic, slope


def before_measurement(belief: Belief, times: np.ndarray, bar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bars of the simulated position and velocity, (T, M, 3), for the bar of what the measurement shows."""
    if "length_scale" in belief.effects:
        bar = bar * (1.0 + belief["length_scale.scale"].value)
    if "frame_drift" in belief.effects:
        turn = np.array([belief[f"frame_drift.w_{a}"].value for a in "xyz"])
        bar = bar + times[:, None, None] * np.cross(bar, turn)
    velocity_bar = np.zeros_like(bar)
    if "time_offset" not in belief.effects or len(times) < 2:
        return bar, velocity_bar
    # The cubic through positions and velocities of two frames, the other way round.
    at = np.clip(times + belief["time_offset.offset"].value, times[0], times[-1])
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    span = times[k + 1] - times[k]
    s = (at - times[k]) / span
    late, slope0, slope1 = 3 * s**2 - 2 * s**3, s - 2 * s**2 + s**3, s**3 - s**2
    position_bar = np.zeros_like(bar)
    for target, index, weight in (
        (position_bar, k, 1.0 - late),
        (position_bar, k + 1, late),
        (velocity_bar, k, slope0 * span),
        (velocity_bar, k + 1, slope1 * span),
    ):
        np.add.at(target, index, weight[:, None, None] * bar)
    return position_bar, velocity_bar
