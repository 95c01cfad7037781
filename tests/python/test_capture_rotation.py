"""Conversions of rotations, checked against scipy and against each other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mphygs.capture import rotation

RANDOM = Rotation.random(200, random_state=1)
SPECIAL = Rotation.from_rotvec(
    np.concatenate([np.pi * np.eye(3), 1e-9 * np.eye(3), np.zeros((1, 3)), [[np.pi / np.sqrt(2)] * 2 + [0]]])
)
ALL = Rotation.concatenate([RANDOM, SPECIAL])


def same(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether quaternions are equal up to sign."""
    return bool(np.allclose(np.abs(np.sum(a * b, axis=-1)), 1.0, atol=1e-12))


def test_matrix_from_quaternion_agrees_with_scipy_at_any_length_and_shape() -> None:
    q = ALL.as_quat(scalar_first=True)
    assert np.allclose(rotation.matrix_from_quaternion(q), ALL.as_matrix(), atol=1e-13)
    stacked = rotation.matrix_from_quaternion(-3.0 * q.reshape(2, -1, 4))
    assert np.allclose(stacked.reshape(-1, 3, 3), ALL.as_matrix(), atol=1e-13)


def test_quaternion_from_matrix_is_the_inverse_with_positive_w() -> None:
    q = rotation.quaternion_from_matrix(ALL.as_matrix())
    assert same(q, ALL.as_quat(scalar_first=True))
    assert (q[:, 0] >= 0).all()
    assert np.allclose(np.linalg.norm(q, axis=-1), 1.0)


def test_rotation_vectors_agree_with_scipy() -> None:
    vectors = RANDOM.as_rotvec()
    assert np.allclose(rotation.matrix_from_rotation_vector(vectors), RANDOM.as_matrix(), atol=1e-13)
    assert np.allclose(rotation.rotation_vector_from_matrix(RANDOM.as_matrix()), vectors, atol=1e-9)
    negative = -RANDOM.as_quat(scalar_first=True)
    assert np.allclose(rotation.rotation_vector_from_quaternion(negative), vectors, atol=1e-9)


def test_small_rotation_vectors_keep_their_digits() -> None:
    vectors = np.array([[1e-14, -2e-14, 0], [1e-9, 0, 3e-9], [0, 0, 0]])
    back = rotation.rotation_vector_from_quaternion(rotation.quaternion_from_rotation_vector(vectors))
    assert np.allclose(back, vectors, rtol=1e-9, atol=0)


def test_sign_continuous_turns_flipped_quaternions_back() -> None:
    q = rotation.quaternion_from_rotation_vector(np.linspace(0, 6, 30)[:, None] * [[0.0, 0, 1]])
    flipped = q * np.random.default_rng(0).choice([-1.0, 1.0], (30, 1))
    flipped[0] = q[0]
    assert np.array_equal(rotation.sign_continuous(flipped), q)


def test_align_rigid_finds_a_known_motion() -> None:
    points = np.random.default_rng(2).standard_normal((7, 3))
    for turn in RANDOM.as_matrix()[:20]:
        r, t = rotation.align_rigid(points, points @ turn.T + [1, 2, 3])
        assert np.allclose(r, turn) and np.allclose(t, [1, 2, 3])


def test_align_rigid_never_mirrors() -> None:
    points = np.random.default_rng(3).standard_normal((6, 3))
    r, _ = rotation.align_rigid(points, points * [1, 1, -1])
    assert np.isclose(np.linalg.det(r), 1.0)
    flat = points * [1, 1, 0]
    r, t = rotation.align_rigid(flat, flat)
    assert np.allclose(r, np.eye(3)) and np.allclose(t, 0)


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (np.eye(3)[:2], "at least three"),
        (np.outer(np.arange(5.0), [1, 2, 3]), "one line"),
        (np.ones((4, 3)), "one line"),
        (np.eye(3)[:, :2], "shapes"),
    ],
)
def test_align_rigid_refuses_points_that_fix_no_rotation(points: np.ndarray, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        rotation.align_rigid(points, points)
