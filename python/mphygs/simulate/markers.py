"""Positions of attached points from node states, in torch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor


class _PolarRotation(torch.autograd.Function):
    """R of F = R S. torch's own derivative of the SVD is infinite where singular values meet, as at rest.

    dR = U ((W - W^T) / (s_i + s_j)) V^T with W = U^T dF V; the map from dF to dR is its own adjoint.
    """

    @staticmethod
    def forward(f: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        left, singular, right = torch.linalg.svd(f)
        # A point turned inside out keeps a proper rotation: its smallest singular value changes sign.
        sign = torch.det(left @ right)
        flip = torch.stack([torch.ones_like(sign), torch.ones_like(sign), sign], -1)
        left, singular = left * flip[..., None, :], singular * flip
        return left @ right, left, singular, right

    @staticmethod
    def setup_context(ctx: object, inputs: tuple, output: tuple) -> None:
        ctx.mark_non_differentiable(*output[1:])
        ctx.save_for_backward(*output[1:])
        ctx.save_for_forward(*output[1:])

    @staticmethod
    def _turn(saved: tuple[Tensor, ...], change: Tensor) -> Tensor:
        left, singular, right = saved
        w = left.mT @ change @ right.mT
        return left @ ((w - w.mT) / (singular[..., :, None] + singular[..., None, :])) @ right

    @staticmethod
    def backward(ctx: object, rotation_bar: Tensor, *_: Tensor) -> Tensor:
        return _PolarRotation._turn(ctx.saved_tensors, rotation_bar)

    @staticmethod
    def jvp(ctx: object, tangent: Tensor) -> tuple:
        return _PolarRotation._turn(ctx.saved_tensors, tangent), None, None, None


def polar_rotation(deformation: Tensor) -> Tensor:
    """Rotation (..., 3, 3) of the polar decomposition of deformation gradients (..., 3, 3)."""
    return _PolarRotation.apply(deformation)[0]


@dataclass(frozen=True, eq=False)
class MarkerMap:
    """x = anchor + sum_a N_a u_a + R offset, R the polar rotation of the deformation at the anchor.

    anchor, offset: (M, 3) [m]; node: (M, 27) int64; value: (M, 27); gradient: (M, 27, 3) [1/m].
    """

    anchor: Tensor
    offset: Tensor
    node: Tensor
    value: Tensor
    gradient: Tensor

    @classmethod
    def build(
        cls,
        model: object,
        anchor: np.ndarray,
        offset: np.ndarray,
        cell: np.ndarray,
        dtype: torch.dtype = torch.float64,
    ) -> MarkerMap:
        """anchor, offset: (M, 3) [m]; cell: (M, 3) knot span that carries each point, one of the object's."""
        node, value, gradient = model.weights(anchor, cell)
        return cls(
            torch.as_tensor(anchor, dtype=dtype), torch.as_tensor(offset, dtype=dtype),
            torch.from_numpy(node.astype(np.int64)), torch.from_numpy(value).to(dtype),
            torch.from_numpy(gradient).to(dtype),
        )  # fmt: skip

    def positions(self, displacement: Tensor) -> Tensor:
        """(F, N, 3) node displacements [m] -> (F, M, 3) positions [m]."""
        u = displacement[:, self.node]
        position = self.anchor + torch.einsum("mk,fmkc->fmc", self.value, u)
        if not bool((self.offset != 0).any()):
            return position
        identity = torch.eye(3, dtype=displacement.dtype)
        rotation = polar_rotation(torch.einsum("fmkc,mkj->fmcj", u, self.gradient) + identity)
        return position + torch.einsum("fmij,mj->fmi", rotation, self.offset)
