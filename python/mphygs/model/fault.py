"""Faults of the measurement: they act on what is seen of the simulation, and when. One file each in `faults`,
found there by the registry."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mphygs.model.descriptor import ParameterSpec

Seen = tuple[np.ndarray, np.ndarray]


class Fault:
    """name, summary, parameters: as of every effect. order: those of a lower one act first on what the
    simulation says; leaves_out: measurements are left out for it, and no model has it. What is not written
    here does nothing.

    values: of its parameters; times: (T,) that the measurement states [s]; position [m], velocity [m/s]:
    (T, M, 3).
    """

    name: str
    summary: str
    parameters: tuple[ParameterSpec, ...]
    order: int = 0
    leaves_out: bool = False

    def late(self, values: Mapping[str, float]) -> float:
        """How much later than stated the frames are taken [s]; the simulation shows them then."""
        return 0.0

    def shown(
        self, values: Mapping[str, float], times: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> Seen:
        """What the measurement makes of positions and velocities."""
        return position, velocity

    def pushed(self, values: Mapping[str, float], times: np.ndarray, change: np.ndarray) -> np.ndarray:
        """What it makes of changes of the positions, (T, M, 3, K)."""
        return change

    def derivative(
        self,
        quantity: str,
        values: Mapping[str, float],
        times: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
    ) -> np.ndarray:
        """Derivative of the shown positions by one of its numbers, (T, M, 3) or a shape that spreads to it;
        position, velocity: before it."""
        raise NotImplementedError

    def undone(self, values: Mapping[str, float], times: np.ndarray, position: np.ndarray) -> np.ndarray:
        """The positions that are shown as these, but for the clock."""
        return position

    def pulled(self, values: Mapping[str, float], times: np.ndarray, bar: np.ndarray) -> np.ndarray:
        """Bar of the positions for the bar of the shown ones, (T, M, 3): transpose of `pushed`."""
        return bar
