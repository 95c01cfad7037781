"""The stress-free shape of finite elements whose published shape is in equilibrium: inverse elastostatics.

The unknown is where every node of the published shape lies when no load acts (Govindjee and Mihalic 1996), so
that bricks stay boxes and the load is known.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import NoConvergence, newton_krylov
from scipy.sparse import coo_array
from scipy.sparse.linalg import LinearOperator, splu

from mphygs.simulate.errors import SimulationError
from mphygs.synth.brick_mesh import BrickMesh

# Largest force left at a node, over the largest that acts on one.
BALANCED = 1e-6


def stiffness(mesh: BrickMesh, mu: np.ndarray, lame: np.ndarray) -> coo_array:
    """(3 N, 3 N) [N/m] of small strains about the published shape, unknowns node by node.

    mu, lame: (E, 27) [Pa] at the Gauss points.
    """
    slope = [
        2.0 / mesh.size[:, j, None, None] * mesh.slope[j][None] for j in range(3)
    ]  # (E, 27 Gauss points, 27 nodes)

    def product(weight: np.ndarray, i: int, j: int) -> np.ndarray:
        return np.einsum("eq,eqa,eqb->eab", weight * mesh.volume, slope[i], slope[j], optimize=True)

    laplacian = sum(product(mu, k, k) for k in range(3))
    rows, columns, values = [], [], []
    for i in range(3):
        for j in range(3):
            block = product(lame, i, j) + product(mu, j, i)
            if i == j:
                block = block + laplacian
            rows.append(np.broadcast_to(3 * mesh.element[:, :, None] + i, block.shape).ravel())
            columns.append(np.broadcast_to(3 * mesh.element[:, None, :] + j, block.shape).ravel())
            values.append(block.ravel())
    size = 3 * len(mesh.nodes)
    return coo_array(
        (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(size, size)
    )


def unloaded(
    mesh: BrickMesh,
    held: np.ndarray,
    matrix: coo_array,
    inside: Callable[[np.ndarray], np.ndarray],
    load: np.ndarray,
) -> np.ndarray:
    """Displacement (N, 3) [m] from the published to the stress-free shape.

    held: (N,) bool, nodes that stay; matrix: as of `stiffness`; inside: internal force (N, 3) [N] at such a
    displacement; load: (N, 3) [N] on the published shape. Raises SimulationError where no shape is found.
    """
    free = np.repeat(~held, 3)
    solve = splu(matrix.tocsc()[np.ix_(free, free)])
    near = LinearOperator((free.sum(), free.sum()), matvec=lambda r: solve.solve(np.ravel(r)))

    def full(x: np.ndarray) -> np.ndarray:
        out = np.zeros(3 * len(mesh.nodes))
        out[free] = np.ravel(x)
        return out.reshape(-1, 3)

    def unbalanced(x: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            return (inside(full(x)) + load).ravel()[free]

    largest = float(np.abs(load).max())
    start = -solve.solve(load.ravel()[free])
    try:
        found = newton_krylov(
            unbalanced, start, inner_M=near, f_tol=BALANCED * largest, maxiter=60, rdiff=1e-7
        )
    except (NoConvergence, ValueError) as error:
        raise SimulationError("finite elements: no stress-free shape balances the loads at rest") from error
    return full(found)
