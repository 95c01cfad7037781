"""Smooth motions of a hold: shakes, rocks, shifts and turns whose acceleration is continuous."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.capture.rotation import matrix_from_quaternion, quaternion_from_rotation_vector

KINDS = ("shake", "rock", "shift", "turn")


@dataclass(frozen=True)
class HoldMovement:
    """One movement, between `start` and `stop` [s].

    shake: by sin(2 pi f (t - start)), by: (3,) [m]; rock: the same about `axis` by `degrees`; both swell and
    fade over `ramp` [s]. shift: by `by` [m], turn: about `axis` by `degrees`, once, from start to stop.
    """

    kind: str
    start: float
    stop: float
    by: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    degrees: float = 0.0
    frequency: float = 1.0
    ramp: float = 0.2

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"motion '{self.kind}': expected one of {', '.join(KINDS)}")
        if not self.start < self.stop:
            raise ValueError(
                f"motion '{self.kind}': starts at {self.start} s, expected before its stop at {self.stop} s"
            )
        if self.kind in ("shake", "rock") and not 0.0 < self.ramp <= 0.5 * (self.stop - self.start):
            raise ValueError(
                f"motion '{self.kind}': ramp {self.ramp} s, expected above 0 and at most half its duration"
            )

    def course(self, times: np.ndarray) -> np.ndarray:
        """(T,) share of the full movement at times [s]."""
        if self.kind in ("shift", "turn"):
            return ramp((times - self.start) / (self.stop - self.start))
        envelope = ramp((times - self.start) / self.ramp) * ramp((self.stop - times) / self.ramp)
        return envelope * np.sin(2.0 * np.pi * self.frequency * (times - self.start))


def ramp(share: np.ndarray) -> np.ndarray:
    """From 0 to 1 over [0, 1] with first and second derivatives 0 at both ends (a polynomial of degree 5)."""
    s = np.clip(share, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def hold_poses(
    motions: Sequence[HoldMovement], times: np.ndarray, pivot: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pose of what is held: position (T, 3) [m] and quaternion (T, 4), X goes to R X + p.

    Rotation vectors and translations of all motions add up; turns are about `pivot` (3,) [m].
    """
    turning, shift = np.zeros((len(times), 3)), np.zeros((len(times), 3))
    for motion in motions:
        course = motion.course(times)[:, None]
        if motion.kind in ("rock", "turn"):
            axis = np.asarray(motion.axis, float)
            turning += course * np.radians(motion.degrees) * axis / np.linalg.norm(axis)
        else:
            shift += course * np.asarray(motion.by, float)
    quaternion = quaternion_from_rotation_vector(turning)
    return shift + pivot - matrix_from_quaternion(quaternion) @ pivot, quaternion
