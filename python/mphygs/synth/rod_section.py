"""What a section of a rod is worth: area, second moments, torsion and shear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Section:
    """A section that is the same about all of its axes.

    area: [m^2]; second: moment of area about any axis through its middle [m^4]; torsion: constant of St.
    Venant [m^4]; outline: its length [m].
    """

    area: float
    second: float
    torsion: float
    outline: float

    def stiffness(self, youngs_modulus: float, poissons_ratio: float) -> np.ndarray:
        """(6,): of a force along the rod and two across it [N], of a moment about it and two across [N m^2].

        Across by the shear coefficient of a round section (Cowper 1966).
        """
        shear = youngs_modulus / (2.0 * (1.0 + poissons_ratio))
        across = shear * self.area * 6.0 * (1.0 + poissons_ratio) / (7.0 + 6.0 * poissons_ratio)
        bending = youngs_modulus * self.second
        return np.array(
            [youngs_modulus * self.area, across, across, shear * self.torsion, bending, bending]
        )


def regular_polygon(radius: float, sides: int) -> Section:
    """The section of a tube's mesh. radius: of its corners [m].

    Torsion as of the circle of the same area, of which it falls short by about 9 / sides^3 (24 sides: 7e-4).
    """
    angle = 2.0 * np.pi / sides
    area = 0.5 * sides * radius**2 * np.sin(angle)
    second = area * radius**2 * (2.0 + np.cos(angle)) / 12.0
    return Section(area, second, area**2 / (2.0 * np.pi), 2.0 * sides * radius * np.sin(0.5 * angle))
