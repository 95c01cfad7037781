"""Gaps of a file that are written as places of exactly zero: seen in the tracks alone, and taken as gaps."""

from __future__ import annotations

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class ZeroGaps(Fault):
    """How many there were."""

    name = "zero_gaps"
    summary = "some marker positions are zeros that stand for gaps"
    parameters = (ParameterSpec("count", "-", 0.0, 0.0, 1e6, 1.0, fitted=False),)
    order = 3
