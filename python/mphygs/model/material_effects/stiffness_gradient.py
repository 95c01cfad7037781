"""Young's modulus of one part that changes from place to place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.material_effect import MaterialChange, MaterialEffect, PointFields, Points, arm_in_part


class StiffnessGradient(MaterialEffect):
    """Exponential along an axis, so that it is nowhere negative."""

    name = "stiffness_gradient"
    summary = "Young's modulus of one part times exp(slope (X - centroid).axis)"
    parameters = (ParameterSpec("slope", "1/m", 0.0, -1000.0, 1000.0, 10.0),)
    order = 1
    settings = ("part", "axis")

    def changed(
        self,
        material: PointFields,
        values: Mapping[str, float],
        settings: Mapping[str, object],
        object_: Points,
    ) -> PointFields:
        """The material with the gradient in the part that the term names."""
        factor = np.exp(values["slope"] * arm_in_part(settings, object_))
        return replace(material, youngs_modulus=material.youngs_modulus * factor)

    def derivative(
        self, quantity: str, values: Mapping[str, float], settings: Mapping[str, object], object_: Points
    ) -> MaterialChange:
        """The arm of every point [m]."""
        return MaterialChange(youngs_modulus=arm_in_part(settings, object_))
