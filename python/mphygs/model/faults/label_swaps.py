"""Markers whose labels change places: seen in the tracks alone, and put right."""

from __future__ import annotations

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class LabelSwaps(Fault):
    """How many markers had another's label for a while."""

    name = "label_swaps"
    summary = "some markers have each other's labels for a while"
    parameters = (ParameterSpec("count", "-", 0.0, 0.0, 1e6, 1.0, fitted=False),)
    order = 3
