"""Where and when a candidate is called for: its score confined to one part and one stretch of time.

Applied to a column of the Jacobian of the fitted parameters it shows which of them would have to drift, and
when.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mphygs.compare.blocks import Blocks
from mphygs.compare.residual_projection import Projection

Array = NDArray[np.float64]


@dataclass(frozen=True)
class BlockScores:
    """Scores of the candidate acting on the observations of one block only, B blocks and q parameters.

    z: (B, q) u_b / sqrt(I_b) of each parameter alone, standard normal under the null; 0 where it does not
    act. statistic: (B,) u_bᵀ I_b⁻¹ u_b of all parameters. degrees: (B,) its degrees of freedom.
    """

    z: Array
    statistic: Array
    degrees: NDArray[np.int_]


def block_scores(residual: Array, projection: Projection, tangent: Array, blocks: Blocks) -> BlockScores:
    """Score of every block. residual: (N,), tangent: (N, q), both whitened, N as the projection's; rows that
    the blocks' index gives the number of no block are in none.

    With a column of ones on one coordinate as tangent this asks for a mean offset of that block.
    """
    remaining = projection.remaining(residual)
    count, columns = len(blocks), tangent.shape[1]
    z, statistic = np.zeros((count, columns)), np.zeros(count)
    degrees = np.zeros(count, dtype=int)
    scale = np.linalg.norm(tangent, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    for b, rows in enumerate(blocks.rows()[:count]):
        local = tangent[rows] / scale
        score = local.T @ remaining[rows]
        seen = projection.basis[rows].T @ local
        gram = local.T @ local
        information = gram - seen.T @ seen
        own = np.diag(information)
        acts = own > 1e-3 * np.maximum(np.diag(gram), 1e-14)
        z[b, acts] = score[acts] / np.sqrt(own[acts])
        values, vectors = np.linalg.eigh(information)
        kept = values > max(1e-10, 1e-8 * float(values[-1]))
        statistic[b] = float(((vectors[:, kept].T @ score) ** 2 / values[kept]).sum())
        degrees[b] = int(kept.sum())
    return BlockScores(z, statistic, degrees)
