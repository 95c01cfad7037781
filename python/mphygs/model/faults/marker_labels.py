"""Few markers whose tracks stand at each other's places throughout: seen before any fit, and put right."""

from __future__ import annotations

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class MarkerLabels(Fault):
    """How many markers have another's track."""

    name = "marker_labels"
    summary = "tracks stand at each other's places throughout"
    parameters = (ParameterSpec("count", "-", 0.0, 0.0, 1e6, 1.0, fitted=False),)
    order = 3
