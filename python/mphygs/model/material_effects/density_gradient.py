"""Density of one part that changes from place to place."""

from __future__ import annotations

from mphygs.model.material_effect import PartGradient


class DensityGradient(PartGradient):
    """Density, exponential along an axis."""

    name = "density_gradient"
    summary = "density of one part times exp(slope (X - centroid).axis)"
    quantity = "density"
    order = 2
