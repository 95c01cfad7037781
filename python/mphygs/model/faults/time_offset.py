"""A clock that is late."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class TimeOffset(Fault):
    """It has its part where the simulation shows the frames when they were taken."""

    name = "time_offset"
    summary = "frame k shows the state at k/fps + offset"
    parameters = (ParameterSpec("offset", "s", 0.0, -1.0, 1.0, 0.01),)

    def late(self, values: Mapping[str, float]) -> float:
        """The offset [s]."""
        return values["offset"]

    def derivative(
        self,
        quantity: str,
        values: Mapping[str, float],
        times: np.ndarray,
        position: np.ndarray,
        velocity: np.ndarray,
    ) -> np.ndarray:
        """The velocity."""
        return velocity
