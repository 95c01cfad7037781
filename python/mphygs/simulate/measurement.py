"""Faults of the measurement: what they make of the simulated markers, forwards and back."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mphygs.model.belief import Belief, Parameter


def frames_beyond(belief: Belief, fps: float) -> int:
    """Frames to simulate after the last one that is shown: a late measurement shows what comes after it."""
    if "time_offset" not in belief.effects:
        return 0
    return max(math.ceil(belief["time_offset.offset"].value * fps - 1e-9), 0)


def measured(
    belief: Belief,
    wanted: Sequence[tuple[Belief, Parameter]],
    times: np.ndarray,
    shown: int,
    position: np.ndarray,
    velocity: np.ndarray,
    jacobian: np.ndarray,
    rates: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faults of the measurement, applied to what the simulation says, in the first `shown` of its frames.

    times: (T,) [s], `frames_beyond` more than are shown; position, velocity: (T, M, 3); jacobian, and where
    the belief has a time offset `rates`: (T, M, 3, K), of positions and velocities by the wanted parameters,
    whose columns of faults are filled.
    """
    if "time_offset" in belief.effects:
        shift = belief["time_offset.offset"].value
        if jacobian.shape[-1]:
            jacobian, _ = _shifted(times, shown, jacobian, rates, shift)
        position, velocity = _shifted(times, shown, position, velocity, shift)
    position, velocity, jacobian = position[:shown], velocity[:shown], jacobian[:shown]
    t = times[:shown, None, None]
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


def _cubic_weights(times: np.ndarray, shown: int, shift: float) -> tuple[np.ndarray, ...]:
    """The cubic through positions and velocities of two frames, at the first `shown` times + shift: the
    earlier frame k (shown,), the span between the two [s], and the place s in it, from 0 to 1."""
    at = np.clip(times[:shown] + shift, times[0], times[-1])
    k = np.clip(np.searchsorted(times, at, side="right") - 1, 0, len(times) - 2)
    span = times[k + 1] - times[k]
    return k, span, (at - times[k]) / span


def _shifted(
    times: np.ndarray, shown: int, position: np.ndarray, velocity: np.ndarray, shift: float
) -> tuple[np.ndarray, np.ndarray]:
    """State at the first `shown` times + shift; position, velocity: (T, ...)."""
    if len(times) < 2:
        return position[:shown], velocity[:shown]
    k, span, s = (a.reshape(-1, *[1] * (position.ndim - 1)) for a in _cubic_weights(times, shown, shift))
    k = k.ravel()
    p0, p1, v0, v1 = position[k], position[k + 1], velocity[k] * span, velocity[k + 1] * span
    cubic = p0 + s * v0 + s**2 * (3 * (p1 - p0) - 2 * v0 - v1) + s**3 * (2 * (p0 - p1) + v0 + v1)
    slope = (v0 + 2 * s * (3 * (p1 - p0) - 2 * v0 - v1) + 3 * s**2 * (2 * (p0 - p1) + v0 + v1)) / span
    return cubic, slope


def before_measurement(belief: Belief, times: np.ndarray, bar: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bars of the simulated position and velocity, (T, M, 3), for the bar of what the measurement shows.

    times: (T,) [s]; bar: (S, M, 3), of the first S of these.
    """
    shown = len(bar)
    if "length_scale" in belief.effects:
        bar = bar * (1.0 + belief["length_scale.scale"].value)
    if "frame_drift" in belief.effects:
        turn = np.array([belief[f"frame_drift.w_{a}"].value for a in "xyz"])
        bar = bar + times[:shown, None, None] * np.cross(bar, turn)
    velocity_bar = np.zeros((len(times), *bar.shape[1:]))
    if "time_offset" not in belief.effects or len(times) < 2:
        return bar, velocity_bar
    # The cubic through positions and velocities of two frames, the other way round.
    k, span, s = _cubic_weights(times, shown, belief["time_offset.offset"].value)
    late, slope0, slope1 = 3 * s**2 - 2 * s**3, s - 2 * s**2 + s**3, s**3 - s**2
    position_bar = np.zeros_like(velocity_bar)
    for target, index, weight in (
        (position_bar, k, 1.0 - late),
        (position_bar, k + 1, late),
        (velocity_bar, k, slope0 * span),
        (velocity_bar, k + 1, slope1 * span),
    ):
        np.add.at(target, index, weight[:, None, None] * bar)
    return position_bar, velocity_bar
