"""Noise that all markers of a frame share: seen on those that cannot move, and weighed as it is."""

from __future__ import annotations

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class CommonShake(Fault):
    """Its standard deviation in a coordinate."""

    name = "common_shake"
    summary = "all markers jump together from frame to frame"
    parameters = (ParameterSpec("sigma", "m", 0.0, 0.0, 1.0, 1e-3, fitted=False),)
    order = 3
