"""The grouping losses of M-PhyGs: what looks alike is of like material."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from torch import Tensor

NEIGHBOURS = 20
ALPHA = 20.0
LEAST_WEIGHT = 1e-9


@dataclass(frozen=True, eq=False)
class Likeness:
    """Who looks like whom. index: (N, M), the M nearest of N in appearance; weight: (N, M), of rows
    that add up to 1."""

    index: Tensor
    weight: Tensor


def likeness(
    appearance: np.ndarray, *, neighbours: int = NEIGHBOURS, alpha: float = ALPHA, least: float = LEAST_WEIGHT
) -> Likeness:
    """The `neighbours` nearest in zD space of each of N, itself left out, with weights
    w_ij = exp(-alpha |zD_i - zD_j|^2) + least, normalised over j. appearance: (N, D) zD.

    Raises ValueError where there are not more than `neighbours`.
    """
    import torch

    values = np.ascontiguousarray(appearance, dtype=np.float64)
    count = len(values)
    if not 1 <= neighbours < count:
        raise ValueError(f"neighbours: {neighbours} of {count}; expected 1 to {count - 1}")
    distance, index = cKDTree(values).query(values, k=neighbours + 1)
    # itself is among them, at distance zero, but not always first where others are equal
    own = index == np.arange(count)[:, None]
    own[~own.any(axis=1), -1] = True
    index = index[~own].reshape(count, neighbours)
    square = distance[~own].reshape(count, neighbours) ** 2
    weight = np.exp(-alpha * square) + least
    weight /= weight.sum(axis=1, keepdims=True)
    return Likeness(torch.from_numpy(index), torch.from_numpy(weight))


def likeness_loss(log_modulus: Tensor, log_density: Tensor, alike: Likeness) -> Tensor:
    """L_s = 1/N sum_i sum_j w_ij ((log E_i - log E_j)^2 + (log rho_i - log rho_j)^2), of (N,) each."""
    total = log_modulus.new_zeros(())
    for values in (log_modulus, log_density):
        weight = alike.weight.to(values.dtype)
        total = total + (weight * (values[:, None] - values[alike.index]) ** 2).sum(dim=1).mean()
    return total


def variance_loss(log_modulus: Tensor, log_density: Tensor) -> Tensor:
    """L_v = var(log E) + var(log rho), of (N,) each, about the mean over all particles."""
    return log_modulus.var(unbiased=False) + log_density.var(unbiased=False)


def grouping_loss(
    log_modulus: Tensor, log_density: Tensor, alike: Likeness, *, variance_weight: float = 1.0
) -> Tensor:
    """L_g = L_s + w_v L_v."""
    spread = variance_loss(log_modulus, log_density)
    return likeness_loss(log_modulus, log_density, alike) + variance_weight * spread


def segment_coupling(alike: Likeness, label: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Symmetric (S, S) matrices A, B with L_s = a' A a and L_v = a' B a for one quantity a (S,) a segment.

    label: (N,) int, segments of the particles; count: S. With them the losses are rows of a least-squares
    problem in few unknowns.
    """
    label = np.asarray(label)
    particles, neighbours = alike.index.shape
    first = np.repeat(label, neighbours)
    second = label[alike.index.numpy().ravel()]
    weight = sparse.coo_matrix(
        (alike.weight.numpy().ravel(), (first, second)), shape=(count, count)
    ).toarray()
    weight = 0.5 * (weight + weight.T) / particles
    pull = 2.0 * (np.diag(weight.sum(axis=1)) - weight)
    share = np.bincount(label, minlength=count) / particles
    return pull, np.diag(share) - np.outer(share, share)
