"""An affinity feature: Gaussians that pictures show in one group, at any scale, lie close together in it.

As in GARField (Kim et al. 2024) the groups are those of masks in many views, coarse and fine. Where there a
field is trained by contrast, here the Gaussians are few, and the embedding that keeps members of a group
together best has a closed form: the leading singular vectors of who is in which group (spectral
co-clustering, Dhillon 2001; the relaxed normalised cut of Shi and Malik 2000).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import svds

_LEAST_AMOUNT = 1e-6


def affinity_features(
    membership: sparse.spmatrix, neighbours: sparse.spmatrix, *, count: int, bond: float = 0.1
) -> np.ndarray:
    """Affinity features (K, A), A = `count`, of K Gaussians; their squared distances are 1 in the mean.

    membership: (K, G) >= 0, what is seen of each Gaussian in each group; neighbours: (K, L) >= 0, further
    groups of places close together, that join what no picture joins, counting `bond` times as much.
    Raises ValueError for fewer than A + 2 Gaussians or no groups.
    """
    rows = sparse.csr_matrix(membership, dtype=np.float64)
    if rows.shape[0] < count + 2 or rows.shape[1] == 0:
        raise ValueError(f"membership: has shape {rows.shape}; expected at least ({count + 2}, 1)")
    rows = _per_row(rows)
    joined = sparse.hstack([rows, bond * _per_row(sparse.csr_matrix(neighbours, dtype=np.float64))]).tocsr()
    amount = np.maximum(np.asarray(joined.sum(axis=1))[:, 0], _LEAST_AMOUNT)
    size = np.maximum(np.asarray(joined.sum(axis=0))[0], _LEAST_AMOUNT)
    balanced = sparse.diags(amount**-0.5) @ joined @ sparse.diags(size**-0.5)
    wanted = min(count + 1, min(balanced.shape) - 1)
    start = np.ones(min(balanced.shape)) / np.sqrt(min(balanced.shape))
    left, values, _ = svds(balanced, k=wanted, v0=start)
    order = np.argsort(-values)[1:]  # the first is the same for all
    vectors = left[:, order] * amount[:, None] ** -0.5 * values[order] ** 2
    vectors *= np.sign(vectors[np.abs(vectors).argmax(axis=0), np.arange(vectors.shape[1])])
    spread = np.sqrt(2.0 * vectors.var(axis=0).sum())
    scaled = vectors / max(spread, 1e-300)
    return np.pad(scaled, ((0, 0), (0, count - scaled.shape[1]))).astype(np.float32)


def neighbour_groups(index: np.ndarray) -> sparse.csr_matrix:
    """Groups (K, K) of each of K places and its neighbours; index: (K, M) of them, itself among them."""
    count, size = index.shape
    groups = np.repeat(np.arange(count), size)
    return sparse.csr_matrix((np.ones(count * size), (index.ravel(), groups)), shape=(count, count))


def _per_row(matrix: sparse.csr_matrix) -> sparse.csr_matrix:
    """Rows that add up to 1: every Gaussian counts the same, however much is seen of it."""
    amount = np.asarray(matrix.sum(axis=1))[:, 0]
    return (
        sparse.diags(np.where(amount > _LEAST_AMOUNT, 1.0 / np.maximum(amount, _LEAST_AMOUNT), 0.0)) @ matrix
    )
