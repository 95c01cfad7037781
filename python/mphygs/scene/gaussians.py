"""An object as a set of anisotropic 3D Gaussians (Kerbl et al. 2023)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor

HARMONIC_COUNTS = (1, 4, 9, 16)  # of degree 0 to 3
CONSTANT_HARMONIC = 0.28209479177387814  # the harmonic of degree 0


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N Gaussians; torch tensors, which may carry gradients.

    positions: (N, 3) [m]; rotations: (N, 4) wxyz, of any length; scales: (N, 3), standard deviations along
    the rotated axes [m]; opacities: (N,), 0 to 1; harmonics: (N, K, 3), coefficients of red, green, blue with
    K = 1, 4, 9 or 16 (degree 0 to 3), colour = 1/2 + sum; features: (N, F), any channels, F may be 0.
    Raises ValueError, one line, for shapes that do not fit together.
    """

    positions: Tensor
    rotations: Tensor
    scales: Tensor
    opacities: Tensor
    harmonics: Tensor
    features: Tensor

    def __post_init__(self) -> None:
        count = len(self.positions)
        if self.harmonics.ndim != 3 or self.harmonics.shape[1] not in HARMONIC_COUNTS:
            raise ValueError(
                f"harmonics: have shape {tuple(self.harmonics.shape)}; expected (N, 1, 4, 9 or 16, 3)"
            )
        feature_count = self.features.shape[1] if self.features.ndim == 2 else -1
        expected = {
            "positions": (count, 3),
            "rotations": (count, 4),
            "scales": (count, 3),
            "opacities": (count,),
            "harmonics": (count, self.harmonics.shape[1], 3),
            "features": (count, feature_count),
        }
        for name, shape in expected.items():
            have = tuple(getattr(self, name).shape)
            if have != shape:
                wanted = str(shape).replace("-1", "F")
                raise ValueError(f"{name}: have shape {have}; expected {wanted}")

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return len(self.positions)

    @property
    def degree(self) -> int:
        """Degree of the colour's spherical harmonics, 0 to 3."""
        return HARMONIC_COUNTS.index(self.harmonics.shape[1])

    def each(self, change: Callable[[Tensor], Tensor]) -> Gaussians:
        """The Gaussians with `change` done to every tensor, e.g. an index or a dtype."""
        return Gaussians(**{field.name: change(getattr(self, field.name)) for field in fields(self)})

    def tensors(self) -> tuple[Tensor, ...]:
        """The tensors in the order of the fields."""
        return tuple(getattr(self, field.name) for field in fields(self))


def joined_gaussians(first: Gaussians, second: Gaussians) -> Gaussians:
    """The Gaussians of both, of the same degree and number of features."""
    import torch

    return Gaussians(*(torch.cat(pair) for pair in zip(first.tensors(), second.tensors(), strict=True)))


def harmonics_of_colour(colours: Tensor, degree: int = 0) -> Tensor:
    """Coefficients (N, K, 3) that give colours (N, 3), 0 to 1, in every direction of sight."""
    harmonics = colours.new_zeros(len(colours), HARMONIC_COUNTS[degree], 3)
    harmonics[:, 0] = (colours - 0.5) / CONSTANT_HARMONIC
    return harmonics


def colour_of_harmonics(harmonics: Tensor) -> Tensor:
    """The mean colours (N, 3) over all directions of harmonics (N, K, 3), held within 0 and 1."""
    return (harmonics[:, 0] * CONSTANT_HARMONIC + 0.5).clamp(0.0, 1.0)
