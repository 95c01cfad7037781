"""Loads that are given frame by frame, on finite elements: forces, tendons, pressures on the surface."""

from __future__ import annotations

import numpy as np

from mphygs.capture.actuators import Actuator, Force, Pressure, Tendon
from mphygs.capture.holds import Hold
from mphygs.synth.brick_mesh import SAME, BrickMesh
from mphygs.synth.finite_element_stress import cofactor


class Driven:
    """One actuator on the nodes of a mesh."""

    def __init__(
        self,
        actuator: Actuator,
        mesh: BrickMesh,
        hold: Hold,
        parts: tuple[str, ...],
        fps: float,
        share: np.ndarray | None,
    ) -> None:
        """parts: their names; share: (N,) of every node in a force."""
        self._actuator, self._hold, self._fps, self._share = actuator, hold, fps, share
        self._span = (
            actuator.start_frame / fps,
            np.inf if actuator.end_frame is None else actuator.end_frame / fps,
        )
        if isinstance(actuator, Tendon):
            self._rows = mesh.weights(actuator.path)
            low, high = hold.box
            self._held = np.all((actuator.path >= low - SAME) & (actuator.path <= high + SAME), axis=1)
        elif isinstance(actuator, Pressure):
            part = None if actuator.part is None else parts.index(actuator.part)
            self._patch = mesh.patch(part, actuator.box)

    def force(self, x: np.ndarray, time: float) -> np.ndarray:
        """(N, 3) [N] where the nodes are at x (N, 3) [m]."""
        if not self._span[0] <= time < self._span[1]:
            return np.zeros_like(x)
        size = self._actuator.course(np.array([time]), self._fps)[0]
        if isinstance(self._actuator, Force):
            return self._share[:, None] * size
        if isinstance(self._actuator, Tendon):
            return self._rows.T @ self._pulled(self._rows @ x, float(size), time)
        # Nanson's formula: the area that an area of the published shape has become.
        grown = cofactor(np.stack([slope @ x for slope in self._patch.slope]).transpose(2, 0, 1))
        return self._patch.value.T @ (-float(size) * np.einsum("ijm,mj->mi", grown, self._patch.area))

    def _pulled(self, at: np.ndarray, tension: float, time: float) -> np.ndarray:
        """(P, 3) [N] on the points of a tendon at (P, 3) [m]; what pulls at the hold goes there."""
        rotation, shift = self._hold.poses(np.array([time]), self._fps)
        at = np.where(self._held[:, None], self._actuator.path @ rotation[0].T + shift[0], at)
        anchor = self._actuator.anchor
        line = at if anchor is None else np.concatenate([at, anchor[None]])
        step = np.diff(line, axis=0)
        along = tension * step / np.linalg.norm(step, axis=1, keepdims=True)
        force = np.zeros_like(line)
        force[:-1] += along
        force[1:] -= along
        return np.where(self._held[:, None], 0.0, force[: len(at)])
