"""Bricks of second order over an object of boxes, by scikit-fem: the other way to discretise it.

Twenty-seven nodes a brick at Gauss-Lobatto points, so that the mass is diagonal, and 27 Gauss points. What
scikit-fem makes once, mesh, numbering, shape functions and quadrature, is kept here as arrays that a step in
time contracts: its own assembly in every step takes several times as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array
from skfem import Basis, ElementHex2, FacetBasis, LinearForm, MeshHex
from skfem.quadrature import get_quadrature

from mphygs.capture.meshes import Part
from mphygs.scene.rays import inside

# Two coordinates closer than this are one [m].
SAME = 1e-7
# Degree of the polynomials that three Gauss points each way integrate.
DEGREE = 5


@dataclass(repr=False)
class _Bricks(MeshHex):
    """Boxes along the axes."""

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper corners (3, E) [m]."""
        corners = self.p[:, self.t]
        return corners.min(axis=1), corners.max(axis=1)

    def nearest(self, x: np.ndarray) -> np.ndarray:
        """(M,) the brick in which, or nearest to which, points (3, M) [m] lie."""
        low, high = (end[:, None] for end in self.bounds)
        gap = np.maximum(np.maximum(low - x[..., None], x[..., None] - high), 0.0)
        return (gap**2).sum(axis=0).argmin(axis=1)

    def element_finder(self, mapping: object = None) -> object:
        return lambda *x: self.nearest(np.stack(x))


@dataclass(frozen=True, eq=False)
class SurfacePoints:
    """Gauss points on a surface. value: (M, N) shape functions, slope: along x, y, z; area: (M, 3) [m^2] of
    each, outward."""

    value: csr_array
    slope: Sequence[csr_array]
    area: np.ndarray


class BrickMesh:
    """basis: scikit-fem's, at the Gauss points; part: (E,) the part of each brick."""

    def __init__(self, mesh: _Bricks, part: np.ndarray) -> None:
        self.basis = Basis(mesh, ElementHex2(), intorder=DEGREE)
        self.part = part
        # (N, 3) [m]; (E, 27) node indices.
        self.nodes = np.ascontiguousarray(self.basis.doflocs.T)
        self.element = np.ascontiguousarray(self.basis.element_dofs.T)
        low, high = mesh.bounds
        self.size = (high - low).T  # (E, 3) [m]
        # Shape functions (27 Gauss points, 27 nodes), and their slopes along x, y and z in a brick of edge 1
        # (3, 27, 27): bricks are alike but for their sizes.
        self.value = np.stack([np.array(shape)[0] for (shape,) in self.basis.basis], axis=1)
        self.slope = np.stack([shape.grad[:, 0] for (shape,) in self.basis.basis], axis=2)
        self.slope *= self.size[0, :, None, None]
        self.volume = self.basis.dx  # (E, 27) of the Gauss points [m^3]
        self.points = np.moveaxis(np.asarray(self.basis.global_coordinates()), 0, 2)  # (E, 27, 3) [m]

    def lumped(self, density: np.ndarray) -> np.ndarray:
        """(N,) the integral about each node of a density (E, 27) at the nodes of every brick."""
        places = self.basis.elem.doflocs.T
        weights = np.prod(np.where(places == 0.5, 4.0, 1.0) / 6.0, axis=0)
        corners = Basis(self.basis.mesh, self.basis.elem, quadrature=(places, weights))
        return LinearForm(lambda v, w: w["density"] * v).assemble(corners, density=density)

    @cached_property
    def gather(self) -> csr_array:
        """(N, 27 E) sums element values onto nodes."""
        columns = np.arange(self.element.size)
        shape = (len(self.nodes), len(columns))
        return csr_array((np.ones(len(columns)), (self.element.ravel(), columns)), shape=shape)

    @cached_property
    def surface_area(self) -> np.ndarray:
        """(N,) of the free surface, the cut at the hold not counted [m^2]."""
        surface = FacetBasis(self.basis.mesh, self.basis.elem, facets="bare", intorder=DEGREE)
        return LinearForm(lambda v, w: v).assemble(surface)

    def patch(self, part: int | None, box: np.ndarray | None) -> SurfacePoints:
        """The free surface of a part (None: of all) in a box (2, 3) [m] (None: everywhere), which may cut
        through faces of bricks."""
        mesh, mapping = self.basis.mesh, self.basis.mapping
        facets = mesh.boundaries["bare"]
        if part is not None:
            facets = facets[self.part[mesh.f2t[0, facets]] == part]
        corners = mesh.p[:, mesh.facets[:, facets]]
        low, high = corners.min(axis=1), corners.max(axis=1)
        flat = high - low < SAME
        if box is not None:
            low, high = np.maximum(low, box[0][:, None]), np.minimum(high, box[1][:, None])
        seen = np.all(high - low > np.where(flat, -SAME, SAME), axis=0)
        low, high, flat, brick = low[:, seen], high[:, seen], flat[:, seen], mesh.f2t[0, facets[seen]]
        edge = np.where(flat, 0.0, high - low)
        outward = np.where(flat, np.sign(low + high - sum(mesh.bounds)[:, brick]), 0.0)
        area = outward * np.prod(np.where(flat, 1.0, edge), axis=0)
        local, share = get_quadrature(mesh.brefdom, DEGREE)
        # The two axes along each face are the two of its quadrature.
        x = low[..., None] + edge[..., None] * local[np.clip(np.cumsum(~flat, axis=0) - 1, 0, 1)]
        places = mapping.invF(x, tind=brick)
        shapes = [self.basis.elem.gbasis(mapping, places, node, tind=brick)[0] for node in range(27)]
        columns = np.repeat(self.element[brick], len(share), axis=0)
        starts = 27 * np.arange(len(columns) + 1)

        def matrix(values: list[np.ndarray]) -> csr_array:
            data = np.stack(values, axis=-1)
            return csr_array((data.ravel(), columns.ravel(), starts), shape=(len(columns), len(self.nodes)))

        slope = [matrix([shape.grad[axis] for shape in shapes]) for axis in range(3)]
        value = matrix([np.array(s) for s in shapes])
        return SurfacePoints(value, slope, (area[..., None] * share).reshape(3, -1).T)

    def weights(self, points: np.ndarray) -> csr_array:
        """(M, N) shape functions at points (M, 3) [m], of the nearest element where they lie in none."""
        mesh, x = self.basis.mesh, np.asarray(points, float).T
        low, high = (end[:, mesh.nearest(x)] for end in mesh.bounds)
        return csr_array(self.basis.probes(np.clip(x, low, high)))


def brick_mesh(parts: Sequence[Part], hold: np.ndarray, size: float) -> BrickMesh:
    """The material of boxes outside a hold, in bricks of at most `size` [m].

    hold: (2, 3) box [m]; what lies wholly inside it is left out. Raises ValueError for parts that are not
    made of boxes along the axes.
    """
    mesh = _Bricks.init_tensor(*(_lines(parts, hold, axis, size) for axis in range(3)))
    low, high = mesh.bounds
    middle, volume = 0.5 * (low + high).T, np.prod(high - low, axis=0)
    owner = np.full(mesh.nelements, -1)
    for number, part in enumerate(parts):
        own = inside(part, middle)
        if not _of_boxes(part) or not np.isclose(volume[own].sum(), part.volume, atol=0.0):
            raise ValueError(
                f"part '{part.name}': the finite-element simulator knows objects of boxes along the axes only"
            )
        owner[own] = number
    filled = np.flatnonzero(owner >= 0)
    whole = mesh.restrict(filled)
    free = np.flatnonzero(~np.all((middle > hold[0]) & (middle < hold[1]), axis=1)[filled])
    bare = whole.with_boundaries({"bare": whole.boundary_facets()})
    return BrickMesh(bare.restrict(free), owner[filled][free])


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
