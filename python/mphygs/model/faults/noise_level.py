"""Noise that is not as stated, over all or by marker: seen in the tracks alone, and weighed as it is."""

from __future__ import annotations

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class NoiseLevel(Fault):
    """The standard deviation of a coordinate that is used."""

    name = "noise_level"
    summary = "sigma as stated is not sigma as seen"
    parameters = (ParameterSpec("sigma", "m", 0.0, 0.0, 1.0, 1e-3, fitted=False),)
    order = 3
