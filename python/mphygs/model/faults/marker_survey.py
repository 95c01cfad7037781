"""Markers whose stated places are off, each by a constant: seen where they rest, and put right."""

from __future__ import annotations

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.fault import Fault


class MarkerSurvey(Fault):
    """The standard deviation of a coordinate of the stated places."""

    name = "marker_survey"
    summary = "each marker's place on the object is off by a constant"
    parameters = (ParameterSpec("sigma", "m", 0.0, 0.0, 1.0, 1e-3, fitted=False),)
    order = 3
