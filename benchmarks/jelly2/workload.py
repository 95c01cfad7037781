"""The workload `jelly-2`: a column of two neo-Hookean materials, held at its foot, under gravity.

Every peer computes the same substep, so that positions and gradients can be compared:

    P2G  p_i = sum w (m (v + dt g) + A (x_i - x)),  A = m C - 4 dt V / h^2 tau(F),  m_i = sum w m
    G2P  v = sum w p_i / m_i,  C = 4 / h^2 sum w v_i (x_i - x)^T,  x += dt v,  F = (I + dt C) F

with v = (X - x) / (kappa dt) for the particles of the foot.
"""

from dataclasses import dataclass

import numpy as np

SPACING = 0.01  # of the grid [m]; two particles along each axis of a cell
STEP = 1e-4  # [s]
GRAVITY = (0.0, 0.0, -9.81)  # [m/s^2]
DENSITY = 1000.0  # [kg/m^3]
POISSON = 0.3
YOUNG = (1e5, 1e4)  # lower and upper half [Pa]
RELAXATION = 10.0  # kappa
MARGIN = 3  # empty cells around the column, for grids that stay where they are


@dataclass(frozen=True)
class Workload:
    """positions: (N, 3) [m]; material: (N,) 0 or 1; held: (N,) bool."""

    positions: np.ndarray
    material: np.ndarray
    held: np.ndarray
    forward_steps: int
    gradient_steps: int

    @property
    def count(self) -> int:
        """Number of particles."""
        return len(self.positions)

    @property
    def volume(self) -> float:
        """Of a particle [m^3]."""
        return (SPACING / 2) ** 3

    @property
    def mass(self) -> float:
        """Of a particle [kg]."""
        return DENSITY * self.volume

    @property
    def shifted(self) -> np.ndarray:
        """Positions inside a fixed grid that starts at zero, (N, 3) [m]."""
        return self.positions + MARGIN * SPACING

    @property
    def grid(self) -> tuple[int, int, int]:
        """Nodes of that grid."""
        cells = np.ceil(self.positions.max(axis=0) / SPACING).astype(int)
        return tuple(int(c) + 2 * MARGIN for c in cells)


def lame_per_young() -> tuple[float, float]:
    """mu / E and lambda / E."""
    return 1 / (2 * (1 + POISSON)), POISSON / ((1 + POISSON) * (1 - 2 * POISSON))


def jelly2(particles: int, forward_steps: int = 200, gradient_steps: int = 50) -> Workload:
    """A 1:1:4 column of about `particles` particles."""
    width = round((particles / 4) ** (1 / 3))
    height = round(particles / width**2)
    axes = [(np.arange(n) + 0.5) * SPACING / 2 for n in (width, width, height)]
    positions = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    layer = np.tile(np.arange(height), width * width)
    material = (2 * layer >= height).astype(np.int32)
    return Workload(positions, material, layer < 2, forward_steps, gradient_steps)
