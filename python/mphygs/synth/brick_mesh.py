"""Bricks of second order over an object of boxes: the other way to discretise it.

Twenty-seven nodes a brick at Gauss-Lobatto points, so that the mass is diagonal, and 27 Gauss points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from mphygs.capture.meshes import Part
from mphygs.scene.rays import inside

# Two coordinates closer than this are one [m].
SAME = 1e-7
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
    """nodes: (N, 3) [m]; element: (E, 27) node indices; corner, size: (E, 3) [m]; part: (E,); bare: (E, 3, 2)
    bool, whether nothing lies behind the lower and upper face across x, y and z."""

    nodes: np.ndarray
    element: np.ndarray
    corner: np.ndarray
    size: np.ndarray
    part: np.ndarray
    bare: np.ndarray

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
        for axis in range(3):
            across = [a for a in range(3) if a != axis]
            for end in (0, 1):
                outer = self.bare[:, axis, end]
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


def brick_mesh(parts: Sequence[Part], hold: np.ndarray, size: float) -> BrickMesh:
    """The material of boxes outside a hold, in bricks of at most `size` [m].

    hold: (2, 3) box [m]; what lies wholly inside it is left out. Raises ValueError for parts that are not
    made of boxes along the axes.
    """
    axes = [_lines(parts, hold, axis, size) for axis in range(3)]
    counts = [len(a) - 1 for a in axes]
    index = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    corner = np.stack([axes[a][index[:, a]] for a in range(3)], axis=1)
    extent = np.stack([np.diff(axes[a])[index[:, a]] for a in range(3)], axis=1)
    middle = corner + 0.5 * extent
    owner = np.full(len(index), -1)
    for number, part in enumerate(parts):
        own = inside(part, middle)
        if not _of_boxes(part) or not np.isclose(np.prod(extent[own], axis=1).sum(), part.volume, atol=0.0):
            raise ValueError(
                f"part '{part.name}': the finite-element simulator knows objects of boxes along the axes only"
            )
        owner[own] = number
    # One empty cell all around, so that every cell has neighbours.
    filled = np.pad(owner.reshape(counts) >= 0, 1)
    bare = np.stack(
        [[~np.roll(filled, shift, axis)[1:-1, 1:-1, 1:-1].ravel() for shift in (1, -1)] for axis in range(3)]
    ).transpose(2, 0, 1)
    free = (owner >= 0) & ~np.all((middle > hold[0]) & (middle < hold[1]), axis=1)
    inner = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    fine = [np.sort(np.concatenate([a, 0.5 * (a[1:] + a[:-1])])) for a in axes]
    place = 2 * index[free][:, None] + inner
    number = (place[..., 0] * len(fine[1]) + place[..., 1]) * len(fine[2]) + place[..., 2]
    used, element = np.unique(number, return_inverse=True)
    nodes = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1).reshape(-1, 3)[used]
    return BrickMesh(
        nodes, element.reshape(number.shape), corner[free], extent[free], owner[free], bare[free]
    )


def _lines(parts: Sequence[Part], hold: np.ndarray, axis: int, size: float) -> np.ndarray:
    """Coordinates [m] along one axis at which bricks begin and end."""
    low = min(part.vertices[:, axis].min() for part in parts)
    high = max(part.vertices[:, axis].max() for part in parts)
    ends = [x for x in hold[:, axis] if low < x < high]
    given = np.sort(np.concatenate([*(part.vertices[:, axis] for part in parts), ends]))
    given = given[np.concatenate([[True], np.diff(given) > SAME])]
    lines = [given[:1]]
    for start, stop in zip(given[:-1], given[1:], strict=True):
        lines.append(np.linspace(start, stop, int(np.ceil((stop - start) / size - 1e-9)) + 1)[1:])
    return np.concatenate(lines)


def _of_boxes(part: Part) -> bool:
    """Whether every face lies across an axis."""
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    normal = np.abs(np.cross(b - a, c - a))
    return bool((normal.max(axis=1) >= (1.0 - 1e-6) * np.linalg.norm(normal, axis=1)).all())
