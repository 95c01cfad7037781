"""Geometrically exact rods (Simo 1985; Simo and Vu-Quoc 1986): strains, and the forces of their energy.

A node has a place x and a rotation R from rest. Of an element of length L with frame B at rest,

    phi = log(R1^T R2),  stretch = B^T (Rm^T (x2 - x1) - (X2 - X1)) / L,  bend = B^T phi / L,

Rm = R1 exp(phi / 2) being the rotation half way (Crisfield and Jelenic 1999: strains that no rigid motion
changes), and the energy is L/2 times the sum of stiffness times strain squared. Both strains are constant in
an element, so that nothing locks; its error falls with L squared.
"""

from __future__ import annotations

import numpy as np

from mphygs.capture.rotation import matrix_from_rotation_vector, rotation_vector_from_matrix

# Below this angle [rad] series are used.
SMALL = 1e-3


def cross_matrix(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) with cross_matrix(a) b = a x b."""
    out = np.zeros((*vector.shape, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., k, j], out[..., j, k] = vector[..., i], -vector[..., i]
    return out


def turn_of_vector(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) J: exp(v + dv) = exp(v) exp(J dv) for small dv."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < SMALL, 1.0, angle)
    one = np.where(angle < SMALL, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    two = np.where(angle < SMALL, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    k = cross_matrix(vector)
    return np.eye(3) - one * k + two * (k @ k)


def vector_of_turn(vector: np.ndarray) -> np.ndarray:
    """(..., 3, 3) inverse of `turn_of_vector`: log(exp(v) exp(t)) = v + inverse t for small t."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    safe = np.where(angle < SMALL, 1.0, angle)
    exact = (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / safe**2
    two = np.where(angle < SMALL, 1.0 / 12.0 + angle**2 / 720.0, exact)
    k = cross_matrix(vector)
    return np.eye(3) + 0.5 * k + two * (k @ k)


def strains(
    place: np.ndarray, rotation: np.ndarray, frame: np.ndarray, rest: np.ndarray, length: np.ndarray
) -> np.ndarray:
    """(E, 6) stretch and shear, twist and curvature [1/m], in the frame at rest.

    place: (E, 2, 3) [m], rotation: (E, 2, 3, 3) of the elements' nodes; rest: (E, 3) the first to the second
    node at rest [m].
    """
    turn = rotation_vector_from_matrix(np.swapaxes(rotation[:, 0], 1, 2) @ rotation[:, 1])
    middle = rotation[:, 0] @ matrix_from_rotation_vector(0.5 * turn)
    step = _turned_back(middle, place[:, 1] - place[:, 0]) - rest
    return np.concatenate([_turned_back(frame, step), _turned_back(frame, turn)], axis=1) / length[:, None]


def nodal_forces(
    place: np.ndarray,
    rotation: np.ndarray,
    frame: np.ndarray,
    rest: np.ndarray,
    length: np.ndarray,
    stiffness: np.ndarray,
    late: np.ndarray | None = None,
) -> np.ndarray:
    """(E, 2, 6) slope of the energy: by the nodes' places [N], and by turns of them in their own axes [N m].

    stiffness: (E, 6) as of `Section.stiffness`; late: (E, 6) strain that is taken off it.
    """
    turn = rotation_vector_from_matrix(np.swapaxes(rotation[:, 0], 1, 2) @ rotation[:, 1])
    half = matrix_from_rotation_vector(0.5 * turn)
    middle = rotation[:, 0] @ half
    back = _turned_back(middle, place[:, 1] - place[:, 0])
    strain = np.concatenate([_turned_back(frame, back - rest), _turned_back(frame, turn)], axis=1)
    strain = strain / length[:, None]
    if late is not None:
        strain = strain - late
    force, moment = (
        np.einsum("eij,ej->ei", frame, part) for part in np.split(stiffness * strain, 2, axis=1)
    )
    pull = np.einsum("eij,ej->ei", middle, force)
    of_middle = np.cross(force, back)
    of_turn = moment + 0.5 * np.einsum("eji,ej->ei", turn_of_vector(0.5 * turn), of_middle)
    inverse = vector_of_turn(turn)
    first = np.einsum("eij,ej->ei", half, of_middle) - np.einsum("eij,ej->ei", inverse, of_turn)
    second = np.einsum("eji,ej->ei", inverse, of_turn)
    return np.stack(
        [np.concatenate([-pull, first], axis=1), np.concatenate([pull, second], axis=1)], axis=1
    )


def _turned_back(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Transposes of (E, 3, 3) times (E, 3)."""
    return np.einsum("eji,ej->ei", rotation, vector)
