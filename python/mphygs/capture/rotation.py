"""Rotations: the one place where quaternions (w, x, y, z), matrices and rotation vectors are converted.

Those that are differentiated in torch: scene/tensor_rotation.py.
"""

from __future__ import annotations

import numpy as np


def matrix_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4), which need not have unit length."""
    q = np.asarray(quaternion, dtype=np.float64)
    w, x, y, z = np.moveaxis(q, -1, 0)
    scale = 2.0 / np.sum(q * q, axis=-1)
    rows = [
        [1 - scale * (y * y + z * z), scale * (x * y - w * z), scale * (x * z + w * y)],
        [scale * (x * y + w * z), 1 - scale * (x * x + z * z), scale * (y * z - w * x)],
        [scale * (x * z - w * y), scale * (y * z + w * x), 1 - scale * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4), w >= 0, of rotation matrices (..., 3, 3).

    Each of the four rows below is 4 q_i q; the longest is the best conditioned (Shepperd 1978).
    """
    m = np.asarray(matrix, dtype=np.float64)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    yz, zx, xy = m[..., 2, 1] + m[..., 1, 2], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 0] + m[..., 0, 1]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    rows = np.stack(
        [
            np.stack([1 + xx + yy + zz, wx, wy, wz], axis=-1),
            np.stack([wx, 1 + xx - yy - zz, xy, zx], axis=-1),
            np.stack([wy, xy, 1 - xx + yy - zz, yz], axis=-1),
            np.stack([wz, zx, yz, 1 - xx - yy + zz], axis=-1),
        ],
        axis=-2,
    )
    diagonal = np.diagonal(rows, axis1=-2, axis2=-1)
    longest = np.argmax(diagonal, axis=-1)
    q = np.take_along_axis(rows, longest[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.where(q[..., :1] < 0, -q, q)


def quaternion_from_rotation_vector(rotation_vector: np.ndarray) -> np.ndarray:
    """Unit quaternions (..., 4) of rotation vectors (..., 3): axis times angle [rad]."""
    vector = np.asarray(rotation_vector, dtype=np.float64)
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    # np.sinc(x) is sin(pi x) / (pi x), smooth through zero
    return np.concatenate([np.cos(angle / 2), vector * np.sinc(angle / (2 * np.pi)) / 2], axis=-1)


def rotation_vector_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad], of angle at most pi, of quaternions (..., 4)."""
    q = np.asarray(quaternion, dtype=np.float64)
    q = np.where(q[..., :1] < 0, -q, q)
    sine = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2 * np.arctan2(sine, q[..., :1])
    per_sine = np.divide(angle, sine, out=2 / np.maximum(q[..., :1], 0.5), where=sine > 1e-12)
    return q[..., 1:] * per_sine


def matrix_from_rotation_vector(rotation_vector: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of rotation vectors (..., 3) [rad]."""
    return matrix_from_quaternion(quaternion_from_rotation_vector(rotation_vector))


def rotation_vector_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) [rad] of rotation matrices (..., 3, 3)."""
    return rotation_vector_from_quaternion(quaternion_from_matrix(matrix))


def quaternion_by_turn(quaternion: np.ndarray) -> np.ndarray:
    """Derivative (T, 4, 3) of quaternions (T, 4) by a small turn after them, in world axes."""
    w, x, y, z = quaternion.T
    rows = ([-x, -y, -z], [w, z, -y], [-z, w, x], [y, -x, w])
    return 0.5 * np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def sign_continuous(quaternion: np.ndarray) -> np.ndarray:
    """The quaternions (T, 4) with signs turned so that each is nearer to the one before than its negative."""
    q = np.array(quaternion, dtype=np.float64)
    dots = np.sum(q[1:] * q[:-1], axis=-1)
    q[1:] *= np.cumprod(np.where(dots < 0, -1.0, 1.0))[:, None]
    return q


def align_rigid(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation R (3, 3) and translation t (3,) that minimise sum |R source_i + t - target_i|^2 (Kabsch 1976).

    source, target: (N, 3) [m]. Raises ValueError when the points do not fix a rotation: fewer than three,
    or all on one line.
    """
    source = np.asarray(source, dtype=np.float64)
    target = np.asarray(target, dtype=np.float64)
    if source.ndim != 2 or source.shape[1] != 3 or source.shape != target.shape:
        raise ValueError(f"points have shapes {source.shape} and {target.shape}; expected (N, 3) twice")
    if len(source) < 3:
        raise ValueError(f"{len(source)} points do not fix a rotation; expected at least three")
    source_centre, target_centre = source.mean(axis=0), target.mean(axis=0)
    for points in (source - source_centre, target - target_centre):
        spread = np.linalg.svd(points, compute_uv=False)
        if not spread[1] > 1e-6 * spread[0]:
            raise ValueError("the points lie on one line; expected three that do not")
    u, _, vt = np.linalg.svd((target - target_centre).T @ (source - source_centre))
    # the last axis is turned where the best orthogonal matrix would be a reflection
    rotation = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ vt))]) @ vt
    return rotation, target_centre - rotation @ source_centre
