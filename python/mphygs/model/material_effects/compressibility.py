"""Poisson's ratio of all parts, other than the assumed one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from mphygs.model.descriptor import ParameterSpec
from mphygs.model.material_effect import MaterialChange, MaterialEffect, PointFields, Points

if TYPE_CHECKING:
    from mphygs.model.belief import Belief


class Compressibility(MaterialEffect):
    """One ratio in the place of the parts' own."""

    name = "compressibility"
    summary = "Poisson's ratio differs from the assumed one"
    parameters = (ParameterSpec("nu", "-", 0.3, 0.0, 0.495, 0.05),)
    replaces = True

    def start(self, belief: Belief) -> dict[str, float]:
        """The mean of the parts'."""
        return {"nu": float(np.mean([belief[f"{part}.poissons_ratio"].value for part in belief.parts]))}

    def changed(
        self,
        material: PointFields,
        values: Mapping[str, float],
        settings: Mapping[str, object],
        object_: Points,
    ) -> PointFields:
        """The material with the ratio everywhere."""
        return replace(material, poissons_ratio=np.full(material.poissons_ratio.shape, values["nu"]))

    def derivative(
        self, quantity: str, values: Mapping[str, float], settings: Mapping[str, object], object_: Points
    ) -> MaterialChange:
        """One everywhere."""
        return MaterialChange(poissons_ratio=np.ones(object_.points.shape[:2]))
