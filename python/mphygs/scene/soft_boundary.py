"""Particles on a lattice that fills an object and a little more, and how much of each is material."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mphygs.scene.lattice import Lattice

if TYPE_CHECKING:
    from torch import Tensor

SHARPNESS = 5e3  # beta [1/m]
LEAST_SHARE = 1e-4  # epsilon [1]


@dataclass(frozen=True, eq=False)
class Particles:
    """N particles of a regular lattice.

    position: (N, 3) [m]; signed_distance: (N,), from the tentative boundary, negative inside [m]; spacing: of
    the lattice [m]; label: (N,) int, segment; appearance: (N, D), feature of the nearest Gaussian; pixel:
    width at the object of a pixel of the pictures that it was found in [m], None where nobody said.
    Raises ValueError for shapes that do not fit together.
    """

    position: np.ndarray
    signed_distance: np.ndarray
    spacing: float
    label: np.ndarray
    appearance: np.ndarray
    pixel: float | None = None

    def __post_init__(self) -> None:
        count = len(self.position)
        shapes = {
            "position": (count, 3),
            "signed_distance": (count,),
            "label": (count,),
            "appearance": (count, *self.appearance.shape[1:2]),
        }
        for name, shape in shapes.items():
            have = getattr(self, name).shape
            if have != shape:
                raise ValueError(f"{name}: has shape {have}; expected {shape}")
        if not self.spacing > 0:
            raise ValueError(f"spacing: {self.spacing}; expected a length above zero [m]")
        if self.pixel is not None and not self.pixel >= 0:
            raise ValueError(f"pixel: {self.pixel}; expected a length, zero or more [m]")

    @property
    def inside(self) -> np.ndarray:
        """(N,) bool, those within the tentative boundary."""
        return self.signed_distance <= 0.0

    @property
    def resolution(self) -> float:
        """What is smaller was not seen [m]: the pixel, where nobody said the lattice's spacing."""
        return self.spacing if self.pixel is None else self.pixel

    @property
    def segment_count(self) -> int:
        """Number of segments."""
        return int(self.label.max(initial=-1)) + 1


def lattice_particles(
    lattice: Lattice, distance: np.ndarray, *, spacing: float, band: float
) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 3) [m] of a lattice of `spacing` [m] that lie inside or less than `band` [m] outside, and
    their distances (N,) [m]; distance: (X, Y, Z) on `lattice` [m], negative inside."""
    if band < 0 or not spacing > 0:
        raise ValueError(f"spacing {spacing}, band {band}; expected above zero, and zero or more")
    corners = lattice.points(np.array([0, lattice.count - 1]))
    own = Lattice.about(corners, spacing=spacing, margin=0.0)
    points = own.points()
    at = lattice.at(distance, points)
    kept = at <= band
    return points[kept], at[kept]


def soft_volumes(
    signed_distance: Tensor,
    label: Tensor,
    offsets: Tensor,
    *,
    spacing: float,
    sharpness: float = SHARPNESS,
    least_share: float = LEAST_SHARE,
) -> Tensor:
    """Volumes (N,) [m^3] V_i = V_g (sigmoid(-beta (d_i + o_s(i))) + epsilon), differentiable in all.

    signed_distance: (N,) [m], negative inside; label: (N,) int64; offsets: (S,) o_s, one a segment [m]: a
    positive one takes material away; V_g = spacing^3 [m^3]. M-PhyGs (Wada et al.), section 1 of the method.
    """
    share = (-sharpness * (signed_distance + offsets[label])).sigmoid() + least_share
    return spacing**3 * share
