"""Stress at the Gauss points of the finite elements: the base law and the effects inside the material."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

Values = Mapping[str, float]


def cofactor(f: np.ndarray) -> np.ndarray:
    """(3, 3, Q) of matrices (3, 3, Q)."""
    c = np.empty_like(f)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for a in range(3):
            b, d = (a + 1) % 3, (a + 2) % 3
            c[i, a] = f[j, b] * f[k, d] - f[j, d] * f[k, b]
    return c


def times(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Products (3, 3, Q) of matrices (3, 3, Q)."""
    return np.einsum("ijq,jkq->ikq", a, b)


def transposed(a: np.ndarray) -> np.ndarray:
    """Of (3, 3, Q)."""
    return a.swapaxes(0, 1)


def published(stress: np.ndarray, strained: np.ndarray) -> np.ndarray:
    """First Piola-Kirchhoff stress (3, 3, Q) [Pa] per area of a shape that is `strained` (3, 3, Q)."""
    j = np.einsum("aq,aq->q", strained[0], cofactor(strained)[0])
    return times(stress, transposed(strained)) / j


@dataclass(eq=False)
class MaterialStress:
    """First Piola-Kirchhoff stress of all Gauss points, with the memory of what remembers.

    mu, lame: (Q,) [Pa]; effects: name -> values, of which those of KNOWN act here.
    """

    mu: np.ndarray
    lame: np.ndarray
    effects: Mapping[str, Values]
    _branch: np.ndarray | None = None
    _before: np.ndarray = field(default_factory=lambda: np.zeros(0))

    # Names that `stress` knows.
    KNOWN = ("viscosity", "relaxation", "fibre", "stiffening", "eigenstrain")

    def stress(self, f: np.ndarray, rate: np.ndarray | None, time: float, dt: float) -> np.ndarray:
        """(3, 3, Q) [Pa] for deformation f [-] and its rate [1/s], (3, 3, Q); advances the memory by dt [s].

        rate: may be None where there is no viscosity.
        """
        shrink = 1.0
        if "eigenstrain" in self.effects:
            shrink = np.exp(-self.effects["eigenstrain"]["rate"] * time)
        elastic = shrink * f
        c = cofactor(elastic)
        j = np.einsum("aq,aq->q", elastic[0], c[0])
        base = self.mu * elastic + ((self.lame * np.log(j) - self.mu) / j) * c
        total = base
        if "fibre" in self.effects:
            values = self.effects["fibre"]
            a = np.array([values[f"a_{x}"] for x in "xyz"])
            fa = np.einsum("ijq,j->iq", elastic, a)
            total = total + 2.0 * values["k_f"] * ((fa**2).sum(0) - a @ a) * fa[:, None] * a[None, :, None]
        if "stiffening" in self.effects:
            power, square = j ** (-2.0 / 3.0), np.einsum("ijq,ijq->q", elastic, elastic)
            scale = 4.0 * self.effects["stiffening"]["c_2"] * (power * square - 3.0) * power
            total = total + scale * (elastic - (square / (3.0 * j)) * c)
        if "relaxation" in self.effects:
            total = total + times(elastic, self._relaxed(times(transposed(c) / j, base), dt))
        total = shrink * total
        if "viscosity" in self.effects:
            c_f = c / shrink**2
            d = times(rate, transposed(c_f)) * (self.effects["viscosity"]["eta"] * shrink**3 / j)
            sigma = d + transposed(d)
            sigma -= (np.einsum("iiq->q", sigma) / 3.0) * np.eye(3)[..., None]
            total = total + times(sigma, c_f)
        return total

    def _relaxed(self, second: np.ndarray, dt: float) -> np.ndarray:
        """Stress of the Maxwell branch for the second Piola-Kirchhoff stress now; relaxed at the start."""
        values = self.effects["relaxation"]
        half = np.exp(-0.5 * dt / values["tau"])
        if self._branch is None:
            self._branch = np.zeros_like(second)
        else:
            self._branch = half**2 * self._branch + values["ratio"] * half * (second - self._before)
        self._before = second
        return self._branch
