"""Cubic splines over the middle of a sheet: control points, shape functions, quadrature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, RegularGridInterpolator
from scipy.spatial import cKDTree

from mphygs.synth.shell_sheet import Sheet

DEGREE = 3
# Derivatives of a surface by its two coordinates: none, first, second, mixed.
ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1))
# Of Newton's method for a foot; samples that it begins from, of an element each way.
ROUNDS, SAMPLES = 8, 4


@dataclass(frozen=True, eq=False)
class ShellGrid:
    """A tensor product of splines; coordinates run from 0 to the numbers of elements.

    control: (N, 3) at rest [m], the second coordinate running faster; counts: elements along each.
    """

    control: np.ndarray
    counts: tuple[int, int]

    @classmethod
    def over(cls, sheet: Sheet, size: float) -> ShellGrid:
        """Elements of at most `size` [m], through the sheet's own places."""
        arcs, bases, wanted = [], [], sheet.place
        for axis in (0, 1):
            step = np.linalg.norm(np.diff(sheet.place, axis=axis), axis=2).mean(axis=1 - axis)
            arcs.append(np.r_[0.0, step.cumsum()])
        counts = tuple(max(1, int(np.ceil(arc[-1] / size - 1e-9))) for arc in arcs)
        places = []
        for arc, count in zip(arcs, counts, strict=True):
            knots = _knots(count)
            greville = np.stack([knots[1 + k : 1 + k + count + DEGREE] for k in range(DEGREE)]).mean(axis=0)
            places.append(greville * arc[-1] / count)
            bases.append(_basis(count)(greville))
        at = np.stack(np.meshgrid(*places, indexing="ij"), axis=-1)
        wanted = RegularGridInterpolator(tuple(arcs), sheet.place)(at)
        half = np.linalg.solve(bases[0], wanted.reshape(len(bases[0]), -1)).reshape(wanted.shape)
        control = np.linalg.solve(bases[1], np.swapaxes(half, 0, 1).reshape(len(bases[1]), -1))
        control = np.swapaxes(control.reshape(len(bases[1]), len(bases[0]), 3), 0, 1)
        return cls(control.reshape(-1, 3), counts)

    def shapes(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Control points (Q, 16) that carry coordinates (Q, 2), and their shares (Q, 6, 16), as in ORDERS."""
        index, values = [], []
        for axis, count in enumerate(self.counts):
            x = np.clip(at[:, axis], 0.0, count)
            own = np.clip(np.floor(x).astype(int), 0, count - 1)[:, None] + np.arange(DEGREE + 1)
            basis = _basis(count)
            each = [basis(x) if k == 0 else basis.derivative(k)(x) for k in range(3)]
            index.append(own)
            values.append([np.take_along_axis(e, own, axis=1) for e in each])
        number = index[0][:, :, None] * (self.counts[1] + DEGREE) + index[1][:, None]
        shares = [np.einsum("qi,qj->qij", values[0][a], values[1][b]).reshape(len(at), 16) for a, b in ORDERS]
        return number.reshape(len(at), 16), np.stack(shares, axis=1)

    def quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Coordinates (Q, 2) and weights (Q,) of 4 x 4 Gauss points an element, element by element."""
        point, weight = np.polynomial.legendre.leggauss(DEGREE + 1)
        point, weight = 0.5 * (point + 1.0), 0.5 * weight
        cell = np.stack(np.meshgrid(*map(np.arange, self.counts), indexing="ij"), axis=-1).reshape(-1, 1, 2)
        inner = np.stack(np.meshgrid(point, point, indexing="ij"), axis=-1).reshape(1, -1, 2)
        return (cell + inner).reshape(-1, 2), np.tile(np.outer(weight, weight).ravel(), len(cell))

    def feet(self, points: np.ndarray) -> np.ndarray:
        """(M, 2) coordinates of the places on the middle nearest to points (M, 3) [m], at rest."""
        along = [np.linspace(0.0, n, SAMPLES * n + 1) for n in self.counts]
        dense = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, 2)
        index, shares = self.shapes(dense)
        at = dense[cKDTree(np.einsum("qi,qic->qc", shares[:, 0], self.control[index])).query(points)[1]]
        for _ in range(ROUNDS):
            index, shares = self.shapes(at)
            place, one, two = np.einsum("qoi,qic->oqc", shares[:, :3], self.control[index])
            slope = np.stack([one, two], axis=1)
            gap = np.einsum("qac,qc->qa", slope, points - place)
            at = at + np.linalg.solve(slope @ np.swapaxes(slope, 1, 2), gap[..., None])[..., 0]
            at = np.clip(at, 0.0, self.counts)
        return at


def _knots(count: int) -> np.ndarray:
    return np.r_[np.zeros(DEGREE), np.arange(count + 1.0), np.full(DEGREE, count)]


def _basis(count: int) -> BSpline:
    return BSpline(_knots(count), np.eye(count + DEGREE), DEGREE)
