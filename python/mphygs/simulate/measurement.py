"""Faults of the measurement: what they make of the simulated markers, forwards and back.

The measuring frame drifts first, x -> exp(t [w]) x + t v; the scale is applied to what it then shows.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.capture.rotation import matrix_from_rotation_vector
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

    A late clock has its part already: the simulation shows the frames when they were taken. Under feedback
    the columns of faults hold already what they make of the motion, by moving its targets. times: (T,) that
    the measurement states [s]; position [m], velocity [m/s]: (T, M, 3); jacobian: (T, M, 3, K) by the wanted
    parameters, whose columns of faults are filled here.
    """
    t = times[:, None, None]
    jacobian = jacobian.copy()
    owners = [parameter.key.rpartition(".")[::2] for _, parameter in wanted]
    for slot, (owner, _) in enumerate(owners):
        if owner == "time_offset":
            jacobian[..., slot] += velocity * wanted[slot][1].slope
    shift, turning = _rates(belief)
    if turning.any():
        rotation = matrix_from_rotation_vector(times[:, None] * turning)
        position, velocity = (a @ rotation.transpose(0, 2, 1) for a in (position, velocity))
        jacobian = np.einsum("tij,tmjk->tmik", rotation, jacobian)
        velocity = velocity + np.cross(turning, position)
    about = _swept(times[:, None] * turning)
    for slot, (owner, quantity) in enumerate(owners):
        if owner == "frame_drift":
            axis = "xyz".index(quantity[-1])
            along = np.broadcast_to(np.eye(3)[axis], position.shape)
            moved = along if quantity[0] == "v" else np.cross(about[:, None, :, axis], position)
            jacobian[..., slot] += t * moved * wanted[slot][1].slope
    position, velocity, factor = position + t * shift, velocity + shift, 1.0
    if "length_scale" in belief.effects:
        factor = 1.0 + belief["length_scale.scale"].value
        velocity, jacobian = velocity * factor, jacobian * factor
    for slot, (owner, _) in enumerate(owners):
        if owner == "length_scale":
            jacobian[..., slot] += position * wanted[slot][1].slope
    return position * factor, velocity, jacobian


def unmeasured(belief: Belief, times: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Where the markers truly were, (T, M, 3) [m]: what was measured, less the belief's faults but for the
    clock."""
    if "length_scale" in belief.effects:
        position = position / (1.0 + belief["length_scale.scale"].value)
    shift, turning = _rates(belief)
    position = position - times[:, None, None] * shift
    if turning.any():
        position = position @ matrix_from_rotation_vector(times[:, None] * turning)
    return position


def before_measurement(belief: Belief, times: np.ndarray, bar: np.ndarray) -> np.ndarray:
    """Bar of the simulated positions, (T, M, 3), for the bar of what the measurement shows."""
    if "length_scale" in belief.effects:
        bar = bar * (1.0 + belief["length_scale.scale"].value)
    _, turning = _rates(belief)
    if turning.any():
        bar = bar @ matrix_from_rotation_vector(times[:, None] * turning)
    return bar


def _rates(belief: Belief) -> tuple[np.ndarray, np.ndarray]:
    """Of the measuring frame's drift: velocity (3,) [m/s] and angular velocity (3,) [rad/s]."""
    if "frame_drift" not in belief.effects:
        return np.zeros(3), np.zeros(3)
    return tuple(np.array([belief[f"frame_drift.{kind}_{a}"].value for a in "xyz"]) for kind in "vw")


def _swept(rotation_vector: np.ndarray) -> np.ndarray:
    """(T, 3, 3) J with exp([r + dr]) = exp([J dr]) exp([r]) to first order, for rotation vectors r (T, 3):
    J = sinc I + (1 - sinc) n n^T + (1 - cos) / |r| [n], n the axis."""
    angle = np.linalg.norm(rotation_vector, axis=-1)[:, None, None]
    axis = rotation_vector / np.where(angle > 0.0, angle, 1.0)[..., 0]
    sinc = np.sinc(angle / np.pi)
    # (1 - cos a) / a, without cancellation.
    rise = 0.5 * angle * np.sinc(0.5 * angle / np.pi) ** 2
    cross = np.cross(axis[:, None, :], np.eye(3)).transpose(0, 2, 1)
    return sinc * np.eye(3) + (1.0 - sinc) * axis[:, :, None] * axis[:, None, :] + rise * cross
