"""A small linear model of a body: what a change of the forces on it does, in no time.

Natural modes of the held body about its rest shape. Over half a second of a motion with large turns it still
gives the change of the marker positions to some tens of per cent: not the derivative, but a good guide to it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import expm
from scipy.sparse import bmat, coo_matrix, csc_matrix, diags, identity, kron, spmatrix
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from mphygs import _core
from mphygs.model.belief import Belief
from mphygs.simulate.fields import core_effects, core_inputs, places
from mphygs.simulate.rows import held_rows
from mphygs.simulate.user_effects import forces_of

if TYPE_CHECKING:
    from mphygs.simulate.body import Body
    from mphygs.simulate.prediction import Predictor

# Nodes this many cells apart share no cell: their columns of the stiffness are found together.
APART = 5
# Natural frequencies are sought from here upwards, squared [1/s^2]; below zero a free body is no trouble.
SHIFT = -100.0
# Substep whose tangents give stiffness and damping [s].
PROBE = 1e-5
# Compliance of the rows of holds and joints, over that of the material.
SOFT = 1e-9


@dataclass(frozen=True, eq=False)
class Modes:
    """shape: (N, 3, m), orthonormal in the mass [1/sqrt(kg)]; squared: (m,) frequencies [1/s^2]; damping:
    (m, m) [1/s]; mass: (N,) [kg]."""

    shape: np.ndarray
    squared: np.ndarray
    damping: np.ndarray
    mass: np.ndarray

    def response(self, forces: np.ndarray, spans: np.ndarray) -> np.ndarray:
        """Amplitudes (F + 1, m, K) after each of F intervals, zero before, for modal forces (F, m, K) that
        are constant in each. spans: (F,) length of the intervals [s]."""
        count = len(self.squared)
        scale = np.sqrt(np.maximum(self.squared, 1.0))
        whole = np.zeros((3 * count, 3 * count))
        # q'' + C q' + K q = p as the change of (scale q, q'), with p that does not change.
        whole[:count, count : 2 * count] = np.diag(scale)
        whole[count : 2 * count, :count] = -np.diag(self.squared / scale)
        whole[count : 2 * count, count : 2 * count] = -self.damping
        whole[count : 2 * count, 2 * count :] = np.eye(count)
        lengths, which = np.unique(np.round(spans, 9), return_inverse=True)
        moved = [expm(span * whole) for span in lengths]
        state = np.zeros((2 * count, forces.shape[2]))
        out = np.zeros((len(forces) + 1, count, forces.shape[2]))
        for k, force in enumerate(forces):
            step = moved[which[k]][: 2 * count]
            state = step[:, : 2 * count] @ state + step[:, 2 * count :] @ force
            out[k + 1] = state[:count] / scale[:, None]
        return out


def natural_modes(predictor: Predictor, belief: Belief, count: int) -> Modes:
    """The lowest modes of a held body about its rest shape, fewer where it has not so many."""
    body = predictor.body
    spots = places(belief)
    more = {"places": spots, "place_cell": body.nearest_cell(spots)} if len(spots) else {}
    fields = core_inputs(belief, body)
    if belief.prestress == "equilibrium":
        solution = predictor.rest_shape.solve(belief)
        fields["deformation0"] = solution["deformation0"]
        fields["stress_volume"] = body.quadrature.volumes * solution["volume_ratio"].reshape(-1, 8)
    hook = forces_of(belief, body, np.float64, fields["mass"])
    free = _Unheld(body, fields, core_effects(belief), belief.law, more, hook)
    shape, squared = _lowest(
        free.stiffness(), kron(free.inertia, identity(3)), held_rows(body, free.model.node_index), count
    )
    slowed = free.accelerations([{"velocity0": s} for s in np.moveaxis(shape, -1, 0)])
    damping = -np.einsum("n,nci,jnc->ij", free.mass, shape, slowed)
    return Modes(shape, squared, damping, free.mass)


def lowest_modes(
    body: Body, fields: dict[str, np.ndarray], count: int, *, inertia: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (N, 3, m) and squared frequencies (m,) [1/s^2] of the lowest modes of a held elastic body
    without stress at rest.

    fields: of the core, the material alone; inertia: (3,) factors on the mass by axis.
    """
    free = _Unheld(body, fields, (), "neo-hookean", {}, None)
    weights = kron(free.inertia, diags(inertia))
    return _lowest(free.stiffness(), weights, held_rows(body, free.model.node_index), count)


class _Unheld:
    """A body let go of at rest: its lumped mass (N,) and inertia (N, N) [kg], and how its acceleration
    changes: that which forces give the lumped mass."""

    def __init__(
        self,
        body: Body,
        fields: dict[str, np.ndarray],
        active: tuple[str, ...],
        law: str,
        more: dict[str, np.ndarray],
        hook: object | None,
    ) -> None:
        """more: geometry beside the body's."""
        free = {k: v for k, v in body.geometry.items() if not k.startswith("row_") and k != "hold_count"}
        self.model = _core.TotalLagrangianFloat64(free | more, {"active": list(active), "law": law})
        mass = np.asarray(self.model.node_mass(fields), float)
        self.mass = np.maximum(mass, 1e-9 * mass.mean())
        nodes, shared = self.model.shared_mass(fields)
        self.inertia = diags(self.mass) - coo_matrix((shared, nodes.T), shape=(len(mass), len(mass)))
        still = np.zeros((len(mass), 3))
        self._fields = fields | {"displacement0": still, "velocity0": still}
        self._hook = hook

    def accelerations(self, directions: list[dict[str, np.ndarray]]) -> np.ndarray:
        """(K, N, 3) change of the acceleration in each direction."""
        one = {"steps": [1], "dt": [PROBE], "start": 0.0}
        _, *found = self.model.tangent(self._fields, directions, one, None, self._hook)
        return np.array([(run[1][1] - run[1][0]) / PROBE for run in found])

    def stiffness(self) -> csc_matrix:
        """See `_stiffness`."""
        return _stiffness(self.accelerations, self.mass, self.model.node_index)


def _lowest(
    stiffness: csc_matrix, inertia: spmatrix, held: csc_matrix, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Shapes (N, 3, m) and squared frequencies of the lowest modes with `held` (R, N) u = 0. inertia:
    (3 N, 3 N) [kg]."""
    size = inertia.shape[0]
    inertia = csc_matrix(inertia)
    count = min(count, size - 3 * held.shape[0] - 1)
    shifted = csc_matrix(stiffness - SHIFT * inertia)
    whole = shifted
    if held.shape[0]:
        # Scaled like the stiffness, so that the factors are well conditioned; softened by next to nothing, so
        # that rows which say the same twice do no harm.
        scale = shifted.diagonal().mean()
        rows = kron(held, identity(3)) * scale
        whole = csc_matrix(bmat([[shifted, rows.T], [rows, -SOFT * scale * identity(rows.shape[0])]]))
    factors = splu(whole)

    def solve(right: np.ndarray) -> np.ndarray:
        return factors.solve(np.concatenate([right.ravel(), np.zeros(whole.shape[0] - size)]))[:size]

    squared, shape = eigsh(
        stiffness, k=count, M=inertia, sigma=SHIFT, tol=1e-4,
        OPinv=LinearOperator((size, size), matvec=solve),
        v0=solve(np.random.default_rng(0).standard_normal(size)),
    )  # fmt: skip
    order = np.argsort(squared)
    return shape[:, order].reshape(-1, 3, count), squared[order]


def _stiffness(
    accelerations: Callable[[list[dict[str, np.ndarray]]], np.ndarray], mass: np.ndarray, index: np.ndarray
) -> csc_matrix:
    """Symmetric stiffness (3N, 3N) [N/m] about rest, by columns of nodes that do not meet, together."""
    nodes = len(index)
    colour = (index % APART) @ [APART * APART, APART, 1]
    answer = np.zeros((APART**3, 3, nodes, 3))
    for c in np.unique(colour):
        directions = []
        for axis in range(3):
            push = np.zeros((nodes, 3))
            push[colour == c, axis] = 1.0
            directions.append({"displacement0": push})
        answer[c] = -mass[:, None] * accelerations(directions)
    low = index.min(0) - 2
    shape = np.ptp(index, axis=0) + 5
    number = np.full(shape, -1)
    number[tuple((index - low).T)] = np.arange(nodes)
    rows, columns, values = [], [], []
    here = np.arange(nodes)
    for offset in np.indices((5, 5, 5)).reshape(3, -1).T - 2:
        other = number[tuple((index - low + offset).T)]
        met = other >= 0
        n, o = here[met], other[met]
        block = answer[colour[o], :, n]  # (K, axis of the column, axis of the row)
        for a in range(3):
            for b in range(3):
                rows.append(3 * n + b)
                columns.append(3 * o + a)
                values.append(block[:, a, b])
    place = (np.concatenate(rows), np.concatenate(columns))
    matrix = coo_matrix((np.concatenate(values), place), shape=(3 * nodes, 3 * nodes)).tocsc()
    return csc_matrix(0.5 * (matrix + matrix.T))
