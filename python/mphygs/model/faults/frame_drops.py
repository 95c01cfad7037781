"""Frames lost or repeated, after which the clock is wrong: seen in the tracks alone, and put right."""

from __future__ import annotations

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class FrameDrops(Fault):
    """How many frames the clock jumps by, all together."""

    name = "frame_drops"
    summary = "frames were lost or repeated"
    parameters = (ParameterSpec("count", "-", 0.0, 0.0, 1e6, 1.0, fitted=False),)
    order = 3
