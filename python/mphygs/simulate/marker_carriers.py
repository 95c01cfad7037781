"""Markers carried by what the core computes: nodes or particles, by weights that stay as they are at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.capture.record import Sequence as Recording
from mphygs.simulate.body import Attachment
from mphygs.simulate.timeline import Timeline

# Step of the differences that give the velocity of a hold [s].
_POSE_STEP = 1e-4
# Markers nearer to the material than this stand on it [m].
_ON_MATERIAL = 1e-7


@dataclass(frozen=True, eq=False)
class Carriers:
    """How markers follow carriers, N nodes or particles of the core.

    free: (M,) bool, carried by the material and not by a hold; of these F: index: (F, K) carriers;
    value: (F, K) weights of their displacements; gradient: (F, K, 3) [1/m], weights of the displacement's
    gradient; turning: (F,) bool, markers that stand off the material and turn with it.
    """

    attachment: Attachment
    free: np.ndarray
    index: np.ndarray
    value: np.ndarray
    gradient: np.ndarray
    turning: np.ndarray

    @classmethod
    def of(
        cls,
        attachment: Attachment,
        free: np.ndarray,
        weights: tuple[np.ndarray, np.ndarray, np.ndarray],
    ) -> Carriers:
        """weights: index, value and gradient of the free markers."""
        turning = np.linalg.norm(attachment.offset[free], axis=1) > _ON_MATERIAL
        return cls(attachment, free, *weights, turning)

    def _rotations(self, displacement: np.ndarray) -> tuple[np.ndarray, tuple]:
        """Polar rotation of the deformation at turning markers, (T, M, 3, 3), and its SVD."""
        node, gradient = self.index[self.turning], self.gradient[self.turning]
        f = np.einsum("tmkc,mkj->tmcj", displacement[:, node], gradient) + np.eye(3)
        left, singular, right = np.linalg.svd(f)
        return left @ right, (left, singular, right)

    @property
    def _turning_offset(self) -> np.ndarray:
        return self.attachment.offset[self.free][self.turning]

    def observe(
        self, states: tuple, timeline: Timeline, recording: Recording
    ) -> tuple[np.ndarray, np.ndarray]:
        """Marker positions [m] and velocities [m/s], (T, M, 3), of displacements and velocities (S, N, 3)."""
        a = self.attachment
        frames = len(timeline.frames)
        position = np.broadcast_to(a.anchor + a.offset, (frames, *a.anchor.shape)).copy()
        velocity = np.zeros_like(position)
        u, v = (np.asarray(x, float)[timeline.skipped :] for x in states[:2])
        shown = timeline.shown
        position[shown, self.free] += np.einsum("mk,tmkc->tmc", self.value, u[:, self.index])
        velocity[shown, self.free] = np.einsum("mk,tmkc->tmc", self.value, v[:, self.index])
        if self.turning.any():
            rotation, _ = self._rotations(u)
            index = np.flatnonzero(self.free)[self.turning]
            offset = self._turning_offset
            position[shown, index] += np.einsum("tmij,mj->tmi", rotation, offset) - offset
        times = timeline.clock
        for h, hold in enumerate(recording.held):
            held = np.flatnonzero(a.hold == h)
            if len(held):
                rest = a.anchor[held] + a.offset[held]
                r, p = hold.poses(times, recording.fps)
                r1, p1 = hold.poses(times + _POSE_STEP, recording.fps)
                r0, p0 = hold.poses(times - _POSE_STEP, recording.fps)
                position[:, held] = np.einsum("tij,mj->tmi", r, rest) + p[:, None]
                moved = np.einsum("tij,mj->tmi", r1 - r0, rest) + (p1 - p0)[:, None]
                velocity[:, held] = moved / (2 * _POSE_STEP)
        return position, velocity

    def observe_tangent(self, states: tuple, change: tuple, timeline: Timeline) -> np.ndarray:
        """Derivative of the marker positions, (T, M, 3), for one of the states."""
        out = np.zeros((len(timeline.frames), *self.attachment.anchor.shape))
        u, du = (np.asarray(x[0], float)[timeline.skipped :] for x in (states, change))
        shown = timeline.shown
        out[shown, self.free] = np.einsum("mk,tmkc->tmc", self.value, du[:, self.index])
        if self.turning.any():
            _, (left, singular, right) = self._rotations(u)
            df = np.einsum("tmkc,mkj->tmcj", du[:, self.index[self.turning]], self.gradient[self.turning])
            index = np.flatnonzero(self.free)[self.turning]
            turned = _polar_change(left, singular, right, df)
            out[shown, index] += np.einsum("tmij,mj->tmi", turned, self._turning_offset)
        return out

    def observe_adjoint(
        self,
        states: tuple | None,
        timeline: Timeline,
        position_bar: np.ndarray,
        velocity_bar: np.ndarray,
        count: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bars of the carriers' displacement and velocity, (S, count, 3), for those of the markers.

        states: of the run; None will do where no marker turns. position_bar, velocity_bar: (T, M, 3).
        """
        shown, skipped = timeline.shown, timeline.skipped
        bars = []
        for bar in (position_bar, velocity_bar):
            spread = np.einsum("mk,tmc->tmkc", self.value, bar[shown, self.free])
            bars.append(_scattered(spread, self.index, skipped, count))
        if self.turning.any():
            u = np.asarray(states[0], float)[skipped:]
            _, (left, singular, right) = self._rotations(u)
            bar = position_bar[shown, self.free][:, self.turning]
            rotation_bar = np.einsum("tmi,mj->tmij", bar, self._turning_offset)
            # The map from dF to dR of the polar decomposition is its own adjoint.
            f_bar = _polar_change(left, singular, right, rotation_bar)
            spread = np.einsum("tmcj,mkj->tmkc", f_bar, self.gradient[self.turning])
            bars[0] += _scattered(spread, self.index[self.turning], skipped, count)
        return bars[0], bars[1]


def _polar_change(left: np.ndarray, singular: np.ndarray, right: np.ndarray, df: np.ndarray) -> np.ndarray:
    """dR = U ((W - W^T) / (s_i + s_j)) V^T with W = U^T dF V."""
    w = np.swapaxes(left, -1, -2) @ df @ np.swapaxes(right, -1, -2)
    skew = (w - np.swapaxes(w, -1, -2)) / (singular[..., :, None] + singular[..., None, :])
    return left @ skew @ right


def _scattered(spread: np.ndarray, index: np.ndarray, first: int, count: int) -> np.ndarray:
    """Sums over markers of (T, M, K, 3) at their carriers (M, K), with `first` states of nothing before."""
    out = np.zeros((len(spread) + first, count, 3))
    for t, frame in enumerate(spread):
        np.add.at(out[t + first], index.ravel(), frame.reshape(-1, 3))
    return out
