"""The stress-free shape of finite elements whose published shape is in equilibrium: inverse elastostatics.

The unknown is where every node of the published shape lies when no load acts (Govindjee and Mihalic 1996), so
that bricks stay boxes and the load is known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from scipy.optimize import NoConvergence, newton_krylov
from scipy.sparse import block_array, csc_array, csr_matrix
from scipy.sparse.linalg import LinearOperator, splu
from skfem import Basis, BilinearForm
from skfem.element import DiscreteField
from skfem.helpers import dot

# Largest force left at a node, over the largest that acts on one.
BALANCED = 1e-6


def stiffness(basis: Basis, mu: np.ndarray, lame: np.ndarray) -> csc_array:
    """(3 N, 3 N) [N/m] of small strains about the published shape, unknowns axis by axis.

    mu, lame: (E, 27) [Pa] at the Gauss points.
    """

    def block(i: int, j: int) -> csr_matrix:
        def form(u: DiscreteField, v: DiscreteField, w: Mapping[str, np.ndarray]) -> np.ndarray:
            sheared = dot(u.grad, v.grad) if i == j else 0.0
            return w["lame"] * v.grad[i] * u.grad[j] + w["mu"] * (v.grad[j] * u.grad[i] + sheared)

        return BilinearForm(form).assemble(basis, mu=mu, lame=lame)

    return block_array([[block(i, j) for j in range(3)] for i in range(3)], format="csc")


def unloaded(
    held: np.ndarray,
    matrix: csc_array,
    inside: Callable[[np.ndarray], np.ndarray],
    load: np.ndarray,
) -> np.ndarray:
    """Displacement (N, 3) [m] from the published to the stress-free shape.

    held: (N,) bool, nodes that stay; matrix: as of `stiffness`; inside: internal force (N, 3) [N] at such a
    displacement; load: (N, 3) [N] on the published shape. Raises RuntimeError where no shape is found.
    """
    free = np.tile(~held, 3)
    solve = splu(matrix[free][:, free])
    near = LinearOperator((free.sum(), free.sum()), matvec=lambda r: solve.solve(np.ravel(r)))

    def full(x: np.ndarray) -> np.ndarray:
        out = np.zeros(3 * len(held))
        out[free] = np.ravel(x)
        return out.reshape(3, -1).T

    def unbalanced(x: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):
            return (inside(full(x)) + load).T.ravel()[free]

    largest = float(np.abs(load).max())
    start = -solve.solve(load.T.ravel()[free])
    try:
        found = newton_krylov(
            unbalanced, start, inner_M=near, f_tol=BALANCED * largest, maxiter=60, rdiff=1e-7
        )
    except (NoConvergence, ValueError) as error:
        raise RuntimeError("finite elements: no stress-free shape balances the loads at rest") from error
    return full(found)
