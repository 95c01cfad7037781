"""Positions of attached points from node states, in torch."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from mphygs.scene.tensor_rotation import polar_rotation


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
