"""Markers that do not follow the object: they are found one by one and left out, which no number tells."""

from __future__ import annotations

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class MarkerOutliers(Fault):
    """How many were left out."""

    name = "marker_outliers"
    summary = "some markers do not follow the object"
    parameters = (ParameterSpec("count", "-", 0.0, 0.0, 1e6, 1.0, fitted=False),)
    order = 3
    leaves_out = True
