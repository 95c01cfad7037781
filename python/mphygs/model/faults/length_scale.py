"""A wrong unit of length: what is shown of the drifting frame's points, scaled."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault, Seen


class LengthScale(Fault):
    """Scaled about the origin."""

    name = "length_scale"
    summary = "measured lengths are true ones times 1 + scale"
    parameters = (ParameterSpec("scale", "-", 0.0, -0.5, 0.5, 0.01),)
    order = 2

    def shown(
        self, values: Mapping[str, float], times: np.ndarray, position: np.ndarray, velocity: np.ndarray
    ) -> Seen:
        """Times 1 + scale."""
        factor = 1.0 + values["scale"]
        return position * factor, velocity * factor

    def pushed(self, values: Mapping[str, float], times: np.ndarray, change: np.ndarray) -> np.ndarray:
        """Times 1 + scale."""
        return change * (1.0 + values["scale"])

    def derivative(
        self,
        quantity: str,
        values: Mapping[str, float],
        times: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
    ) -> np.ndarray:
        """The position."""
        return position

    def undone(self, values: Mapping[str, float], times: np.ndarray, position: np.ndarray) -> np.ndarray:
        """Over 1 + scale."""
        return position / (1.0 + values["scale"])

    def pulled(self, values: Mapping[str, float], times: np.ndarray, bar: np.ndarray) -> np.ndarray:
        """Times 1 + scale."""
        return bar * (1.0 + values["scale"])
