"""Bricks of second order over an object of boxes in a row along x: the other way to discretise it.

Twenty-seven nodes a brick at Gauss-Lobatto points, so that the mass is diagonal, and 27 Gauss points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from mphygs.capture.meshes import Part

_LOBATTO = np.array([-1.0, 0.0, 1.0])
_LOBATTO_WEIGHT = np.array([1.0, 4.0, 1.0]) / 3.0
_GAUSS = np.sqrt(0.6) * np.array([-1.0, 0.0, 1.0])
_GAUSS_WEIGHT = np.array([5.0, 8.0, 5.0]) / 9.0


def lagrange(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes (n, 3) at x (n,) in [-1, 1] of the polynomials through -1, 0 and 1."""
    value = np.stack([0.5 * x * (x - 1.0), 1.0 - x**2, 0.5 * x * (x + 1.0)], axis=1)
    return value, np.stack([x - 0.5, -2.0 * x, x + 0.5], axis=1)


def _product(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """(n^3, m^3) of factors (n, m) along x, y and z."""
    return np.kron(np.kron(a, b), c)


@dataclass(frozen=True, eq=False)
class BrickMesh:
    """nodes: (N, 3) [m]; element: (E, 27) node indices; corner, size: (E, 3) [m]; part: (E,)."""

    nodes: np.ndarray
    element: np.ndarray
    corner: np.ndarray
    size: np.ndarray
    part: np.ndarray

    @cached_property
    def value(self) -> np.ndarray:
        """(27 Gauss points, 27 nodes): shape functions."""
        one = lagrange(_GAUSS)[0]
        return _product(one, one, one)

    @cached_property
    def slope(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(27, 27) slopes along x, y and z in an element from -1 to 1."""
        one, d = lagrange(_GAUSS)
        return _product(d, one, one), _product(one, d, one), _product(one, one, d)

    @cached_property
    def points(self) -> np.ndarray:
        """(E, 27, 3) Gauss points [m]."""
        return self.value @ self.nodes[self.element]

    @cached_property
    def volume(self) -> np.ndarray:
        """(E, 27) of the Gauss points [m^3]."""
        weight = _product(*[_GAUSS_WEIGHT[None]] * 3)[0]
        return np.prod(self.size, axis=1)[:, None] / 8.0 * weight

    @cached_property
    def node_volume(self) -> np.ndarray:
        """(E, 27) what each node of each element stands for [m^3]."""
        weight = _product(*[_LOBATTO_WEIGHT[None]] * 3)[0]
        return np.prod(self.size, axis=1)[:, None] / 8.0 * weight

    @cached_property
    def gather(self) -> csr_array:
        """(N, 27 E) sums element values onto nodes."""
        columns = np.arange(self.element.size)
        shape = (len(self.nodes), len(columns))
        return csr_array((np.ones(len(columns)), (self.element.ravel(), columns)), shape=shape)

    @cached_property
    def surface_area(self) -> np.ndarray:
        """(N,) of the free surface, the cut at the hold not counted [m^2]."""
        area = np.zeros(len(self.nodes))
        low, high = self.nodes.min(axis=0), self.nodes.max(axis=0)
        for axis, end in ((0, 1), (1, 0), (1, 1), (2, 0), (2, 1)):
            plane = (low, high)[end][axis]
            across = [a for a in range(3) if a != axis]
            outer = np.isclose((self.corner + end * self.size)[:, axis], plane, atol=1e-9)
            weight = [_LOBATTO_WEIGHT] * 3
            weight[axis] = np.array([1.0 - end, 0.0, end])
            share = np.kron(np.kron(*weight[:2]), weight[2])
            face = np.prod(self.size[:, across], axis=1)[outer] / 4.0
            np.add.at(area, self.element[outer], face[:, None] * share)
        return area

    def weights(self, points: np.ndarray) -> csr_array:
        """(M, N) shape functions at points (M, 3) [m], of the nearest element where they lie in none."""
        gap = np.maximum(np.abs(points[:, None] - self.corner - 0.5 * self.size) - 0.5 * self.size, 0.0)
        owner = (gap**2).sum(axis=2).argmin(axis=1)
        local = 2.0 * (points - self.corner[owner]) / self.size[owner] - 1.0
        x, y, z = (lagrange(local[:, a])[0] for a in range(3))
        value = np.einsum("mi,mj,mk->mijk", x, y, z).reshape(len(points), 27)
        rows = np.repeat(np.arange(len(points)), 27)
        shape = (len(points), len(self.nodes))
        return csr_array((value.ravel(), (rows, self.element[owner].ravel())), shape=shape)


def brick_mesh(parts: Sequence[Part], start: float, size: float) -> BrickMesh:
    """The free material of boxes in a row along x, from x = start [m] on, in bricks of at most `size` [m].

    Raises ValueError for parts that are not boxes of one cross-section.
    """
    bounds = np.array([part.bounds for part in parts])
    boxes = all(np.isclose(part.volume, np.prod(np.ptp(part.bounds, axis=0))) for part in parts)
    if not boxes or not np.allclose(bounds[:, :, 1:], bounds[0, :, 1:]):
        raise ValueError(
            "the finite-element simulator knows boxes of one cross-section in a row along x only"
        )
    lines: list[float] = [start]
    owner: list[int] = []
    for number in np.argsort(bounds[:, 0, 0]):
        low, high = max(bounds[number, 0, 0], start), bounds[number, 1, 0]
        if high > low:
            count = int(np.ceil((high - low) / size - 1e-9))
            lines += np.linspace(low, high, count + 1)[1:].tolist()
            owner += [int(number)] * count
    axes = [np.array(lines)]
    for axis in (1, 2):
        low, high = bounds[0, :, axis]
        axes.append(np.linspace(low, high, int(np.ceil((high - low) / size - 1e-9)) + 1))
    fine = [np.sort(np.concatenate([a, 0.5 * (a[1:] + a[:-1])])) for a in axes]
    nodes = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1).reshape(-1, 3)
    counts = [len(a) - 1 for a in axes]
    index = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.stack([axes[a][index[:, a]] for a in range(3)], axis=1)
    extent = np.stack([np.diff(axes[a])[index[:, a]] for a in range(3)], axis=1)
    inner = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    place = 2 * index[:, None] + inner
    element = (place[..., 0] * len(fine[1]) + place[..., 1]) * len(fine[2]) + place[..., 2]
    return BrickMesh(nodes, element, corner, extent, np.array(owner)[index[:, 0]])
