"""What the rest of synth knows of an object."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mphygs.capture.meshes import Part
from mphygs.synth.rod_net import Line
from mphygs.synth.shell_sheet import Sheet


@dataclass(frozen=True, eq=False)
class Shape:
    """An object at rest, before anything is known of its materials.

    hold: (2, 3) box of what is held [m]; pivot: (3,) point that holds turn about [m]; axis: (3,) unit, the
    long way from the hold to the tip; tip: (3,) material point far from the hold [m]; gravity: (3,) [m/s^2];
    rest: "stress-free" or "equilibrium"; youngs_modulus [Pa] and density [kg/m^3]: usual values per part;
    far_hold, far_pivot: of a second hold, where there is one; lines: of what is a rod; sheet: of what is a
    shell; simulator: what computes its motion usually.
    """

    name: str
    parts: tuple[Part, ...]
    hold: np.ndarray
    pivot: np.ndarray
    axis: np.ndarray
    tip: np.ndarray
    gravity: np.ndarray
    rest: str
    youngs_modulus: Mapping[str, float]
    density: Mapping[str, float]
    far_hold: np.ndarray | None = None
    far_pivot: np.ndarray | None = None
    lines: tuple[Line, ...] = ()
    sheet: Sheet | None = None
    simulator: str = "total-lagrangian"

    @property
    def volume(self) -> float:
        """Of all parts together [m^3]."""
        return sum(part.volume for part in self.parts)

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts."""
        return tuple(part.name for part in self.parts)
