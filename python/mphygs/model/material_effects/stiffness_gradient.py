"""Young's modulus of one part that changes from place to place."""

from __future__ import annotations

from mphygs.model.material_effect import PartGradient


class StiffnessGradient(PartGradient):
    """Young's modulus, exponential along an axis."""

    name = "stiffness_gradient"
    summary = "Young's modulus of one part times exp(slope (X - centroid).axis)"
    quantity = "youngs_modulus"
    order = 1
