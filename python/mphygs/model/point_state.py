"""What an effect in Python is shown of the object, once in every substep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True, eq=False)
class PointState:
    """All N quadrature points at one time.

    position: (N, 3) [m]; velocity: (N, 3) [m/s]; deformation: (N, 3, 3) gradient from the stress-free state
    [-]; mass: (N,) [kg]; volume: (N,) at rest [m^3]; time: [s], frame k is at k / fps; part: (N,) index of
    the part of each point.
    """

    position: Tensor
    velocity: Tensor
    deformation: Tensor
    mass: Tensor
    volume: Tensor
    time: float
    part: Tensor
