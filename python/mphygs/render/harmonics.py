"""Colour by direction of sight: real spherical harmonics of degree 0 to 3, signs and order as in 3DGS."""

from __future__ import annotations

import torch
from torch import Tensor

from mphygs.scene.gaussians import CONSTANT_HARMONIC

_DEGREE_1 = 0.4886025119029199
_DEGREE_2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
_DEGREE_3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)


def harmonic_basis(directions: Tensor, count: int) -> Tensor:
    """The first `count` (1, 4, 9 or 16) harmonics at unit directions (N, 3), (N, count)."""
    x, y, z = directions.unbind(-1)
    xx, yy, zz = x * x, y * y, z * z
    basis = [torch.full_like(x, CONSTANT_HARMONIC)]
    if count > 1:
        basis += [-_DEGREE_1 * y, _DEGREE_1 * z, -_DEGREE_1 * x]
    if count > 4:
        a, b, c = _DEGREE_2
        basis += [a * x * y, -a * y * z, b * (2 * zz - xx - yy), -a * x * z, c * (xx - yy)]
    if count > 9:
        a, b, c, d, e = _DEGREE_3
        basis += [
            -a * y * (3 * xx - yy),
            b * x * y * z,
            -c * y * (4 * zz - xx - yy),
            d * z * (2 * zz - 3 * xx - 3 * yy),
            -c * x * (4 * zz - xx - yy),
            e * z * (xx - yy),
            -a * x * (xx - 3 * yy),
        ]
    return torch.stack(basis, dim=-1)


def seen_colours(harmonics: Tensor, positions: Tensor, eye: Tensor) -> Tensor:
    """Colours (N, 3), at least 0, of harmonics (N, K, 3) at positions (N, 3) [m] seen from eye (3,) [m]."""
    directions = torch.nn.functional.normalize(positions - eye, dim=-1)
    basis = harmonic_basis(directions, harmonics.shape[1])
    return (torch.einsum("nk,nkc->nc", basis, harmonics) + 0.5).clamp_min(0.0)
