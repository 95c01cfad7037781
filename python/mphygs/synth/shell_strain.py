"""Thin shells by Kirchhoff and Love (Kiendl et al. 2009): strains, and the forces of their energy.

Of a middle surface with slopes a_1, a_2 and normal a_3, A at rest,

    e_ab = (a_a . a_b - A_a . A_b) / 2,   k_ab = B_ab - b_ab,   b_ab = a_ab . a_3,

and the energy of an area is t/2 e : C : e + t^3/24 k : C : k (Koiter 1966), C of plane stress.
"""

from __future__ import annotations

import numpy as np

# Of the slopes (Q, 5, 3): a_1, a_2, a_11, a_22, a_12; of a strain: 11, 22, twice 12.
PAIRS = ((0, 0), (1, 1), (0, 1))


def local_axes(slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Strains in square unit axes are (Q, 3, 3) times those by the coordinates; and area over theirs (Q,).

    slopes: (Q, 5, 3) at rest.
    """
    one, two = slopes[:, 0], slopes[:, 1]
    length = np.linalg.norm(one, axis=1)
    along = np.einsum("qc,qc->q", one, two) / length
    area = np.linalg.norm(np.cross(one, two), axis=1)
    # a_1 = length e_1, a_2 = along e_1 + height e_2; its inverse turns the components.
    height = area / length
    inverse = np.zeros((len(one), 2, 2))
    inverse[:, 0, 0], inverse[:, 1, 1] = 1.0 / length, 1.0 / height
    inverse[:, 1, 0] = -along / (length * height)
    out = np.empty((len(one), 3, 3))
    for row, (i, j) in enumerate(PAIRS):
        for column, (a, b) in enumerate(PAIRS):
            both = inverse[:, i, a] * inverse[:, j, b]
            if a != b:
                both = 0.5 * (both + inverse[:, i, b] * inverse[:, j, a])
            out[:, row, column] = (2.0 if i != j else 1.0) * both
    return out, area


def normal(slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals (Q, 3) and lengths (Q,) of a_1 x a_2."""
    cross = np.cross(slopes[:, 0], slopes[:, 1])
    size = np.linalg.norm(cross, axis=1)
    return cross / size[:, None], size


def fundamental(slopes: np.ndarray) -> np.ndarray:
    """(Q, 6): halves of a_11, a_22 and 2 a_12 of the first form, and -b_11, -b_22, -2 b_12 of the second."""
    a3, _ = normal(slopes)
    first = [np.einsum("qc,qc->q", slopes[:, a], slopes[:, b]) for a, b in PAIRS]
    second = np.einsum("qkc,qc->kq", slopes[:, 2:], a3)
    both = [0.5 * first[0], 0.5 * first[1], first[2], -second[0], -second[1], -2.0 * second[2]]
    return np.stack(both, axis=1)


def slope_forces(slopes: np.ndarray, stress: np.ndarray) -> np.ndarray:
    """(Q, 5, 3) slope of the energy of a unit of area by the slopes.

    stress: (Q, 6) by what `fundamental` gives.
    """
    a3, size = normal(slopes)
    n11, n22, n12, m11, m22, m12 = stress.T[:, :, None]
    one, two = slopes[:, 0], slopes[:, 1]
    bent = m11 * slopes[:, 2] + m22 * slopes[:, 3] + 2.0 * m12 * slopes[:, 4]
    pull = -(bent - np.einsum("qc,qc->q", bent, a3)[:, None] * a3) / size[:, None]
    return np.stack(
        [
            n11 * one + n12 * two + np.cross(two, pull),
            n12 * one + n22 * two + np.cross(pull, one),
            -m11 * a3,
            -m22 * a3,
            -2.0 * m12 * a3,
        ],
        axis=1,
    )
