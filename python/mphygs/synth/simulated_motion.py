"""What a simulator of the truth gives: where the markers were and what the sensors read."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True, eq=False)
class SimulatedMotion:
    """Markers in all frames: position (T, M, 3) [m], velocity (T, M, 3) [m/s]; movable: (M,) bool, not
    carried by a hold; substeps: number computed; readings: (T, V, 3) of each of the recording's sensors."""

    position: np.ndarray
    velocity: np.ndarray
    movable: np.ndarray
    substeps: int
    readings: tuple[np.ndarray, ...] = ()

    def after(self, cut: int) -> SimulatedMotion:
        """The motion from a frame on."""
        readings = tuple(value[cut:] for value in self.readings)
        return replace(self, position=self.position[cut:], velocity=self.velocity[cut:], readings=readings)
