"""Rigid motion of the measuring frame, x -> exp(t [w]) x + t v."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mphygs.capture.rotation import matrix_from_rotation_vector
from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault, Seen


class FrameDrift(Fault):
    """Steady: a velocity v and an angular velocity w."""

    name = "frame_drift"
    summary = "rigid motion of the measuring frame"
    parameters = tuple(ParameterSpec(f"v_{a}", "m/s", 0.0, -1.0, 1.0, 1e-3) for a in "xyz") + tuple(
        ParameterSpec(f"w_{a}", "rad/s", 0.0, -1.0, 1.0, 1e-2) for a in "xyz"
    )
    order = 1

    def shown(
        self, values: Mapping[str, float], times: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> Seen:
        """Turned about the origin, then shifted."""
        shift, turning = _rates(values)
        position = self._turned(turning, times, position)
        velocity = self._turned(turning, times, velocity)
        if turning.any():
            velocity = velocity + np.cross(turning, position)
        return position + times[:, None, None] * shift, velocity + shift

    def pushed(self, values: Mapping[str, float], times: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Turned."""
        _, turning = _rates(values)
        if not turning.any():
            return change
        return np.einsum("tij,tmjk->tmik", matrix_from_rotation_vector(times[:, None] * turning), change)

    def derivative(
        self,
        quantity: str,
        values: Mapping[str, float],
        times: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
    ) -> np.ndarray:
        """t e, or t (J e) x position, e the axis of the number."""
        axis, t = "xyz".index(quantity[-1]), times[:, None, None]
        if quantity[0] == "v":
            return t * np.broadcast_to(np.eye(3)[axis], position.shape)
        _, turning = _rates(values)
        about = _swept(times[:, None] * turning)
        return t * np.cross(about[:, None, :, axis], self._turned(turning, times, position))

    def undone(self, values: Mapping[str, float], times: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Shifted and turned back."""
        shift, _ = _rates(values)
        return self.pulled(values, times, position - times[:, None, None] * shift)

    def pulled(self, values: Mapping[str, float], times: np.ndarray, bar: np.ndarray) -> np.ndarray:
        """Turned back."""
        _, turning = _rates(values)
        return bar @ matrix_from_rotation_vector(times[:, None] * turning) if turning.any() else bar

    @staticmethod
    def _turned(turning: np.ndarray, times: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        if not turning.any():
            return vectors
        return vectors @ matrix_from_rotation_vector(times[:, None] * turning).transpose(0, 2, 1)


def _rates(values: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    """Velocity (3,) [m/s] and angular velocity (3,) [rad/s] of the frame."""
    return tuple(np.array([values[f"{kind}_{a}"] for a in "xyz"]) for kind in "vw")


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
