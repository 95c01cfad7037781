"""Rotations that are differentiated, in torch: of deformation gradients, matrices and quaternions wxyz.

Of arrays that are not: capture/rotation.py.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor


def polar_rotation(deformation: Tensor) -> Tensor:
    """The rotation R (..., 3, 3) of the polar decomposition F = R S of deformation gradients (..., 3, 3).

    Its derivative, backward and forward, is that of the decomposition itself and stays finite where stretches
    are equal, as at rest, where that of a singular value decomposition is not. An inverted element is turned
    along its smallest stretch.
    """
    return _Polar.apply(deformation)[0]


class _Polar(torch.autograd.Function):
    """F = U diag(s) V', the sign of det(U V') in U and in the last s: R = U V'. With W = U' dF V,
    dR = U ((W - W') / (s_i + s_j)) V', a map that is its own adjoint."""

    @staticmethod
    def forward(deformation: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        u, s, vh = torch.linalg.svd(deformation.detach())
        sign = torch.ones_like(s)
        sign[..., 2] = torch.det(u @ vh).sign()
        u = u * sign[..., None, :]
        return u @ vh, u, s * sign, vh

    @staticmethod
    def setup_context(ctx: Any, inputs: tuple[Tensor], output: tuple[Tensor, ...]) -> None:
        ctx.mark_non_differentiable(*output[1:])
        ctx.save_for_backward(*output[1:])
        ctx.save_for_forward(*output[1:])

    @staticmethod
    def _turn(saved: tuple[Tensor, ...], change: Tensor) -> Tensor:
        u, s, vh = saved
        w = u.mT @ change @ vh.mT
        # nothing turns about no plane: the diagonal of W - W' is zero whatever it is divided by
        pairs = s[..., :, None] + s[..., None, :]
        pairs = torch.where(torch.eye(3, dtype=torch.bool), 1.0, pairs)
        return u @ ((w - w.mT) / pairs) @ vh

    @staticmethod
    def backward(ctx: Any, rotation_bar: Tensor, *_: Tensor) -> Tensor:
        return _Polar._turn(ctx.saved_tensors, rotation_bar)

    @staticmethod
    def jvp(ctx: Any, tangent: Tensor) -> tuple:
        return _Polar._turn(ctx.saved_tensors, tangent), None, None, None


def quaternions_of_rotations(matrices: Tensor) -> Tensor:
    """Unit quaternions (..., 4) wxyz of rotation matrices (..., 3, 3) (Shepperd 1978)."""
    m = matrices
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    yz, zx, xy = m[..., 2, 1] + m[..., 1, 2], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 0] + m[..., 0, 1]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    # each row is 4 q_i q; the longest is the best conditioned
    rows = torch.stack(
        [
            torch.stack([1 + xx + yy + zz, wx, wy, wz], dim=-1),
            torch.stack([wx, 1 + xx - yy - zz, xy, zx], dim=-1),
            torch.stack([wy, xy, 1 - xx + yy - zz, yz], dim=-1),
            torch.stack([wz, zx, yz, 1 - xx - yy + zz], dim=-1),
        ],
        dim=-2,
    )
    longest = rows.detach().diagonal(dim1=-2, dim2=-1).argmax(dim=-1)
    chosen = torch.gather(rows, -2, longest[..., None, None].expand(*longest.shape, 1, 4))[..., 0, :]
    return torch.nn.functional.normalize(chosen, dim=-1)


def rotation_matrices(rotations: Tensor) -> Tensor:
    """Rotation matrices (N, 3, 3), differentiable, of quaternions (N, 4) wxyz of any length."""
    w, x, y, z = torch.nn.functional.normalize(rotations, dim=-1).unbind(-1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)


def quaternion_product(first: Tensor, second: Tensor) -> Tensor:
    """Quaternions (..., 4) wxyz of the rotation `second` followed by `first`."""
    aw, ax, ay, az = first.unbind(-1)
    bw, bx, by, bz = second.unbind(-1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        dim=-1,
    )
