"""Likelihood gain of a candidate some of whose parameters cannot be negative, and its law under the null.

With score u and information I, the gain is max over e of 2 uᵀe - eᵀ I e, e_k >= 0 where bounded. Under the
null it follows a mixture of chi-squares, weighted by how often each number of parameters is free (Silvapulle
and Sen, Constrained Statistical Inference, 2005, chapter 3).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.stats import beta, chi2

Array = NDArray[np.float64]

# All subsets of bounded parameters are tried up to this many; beyond, one small solve per draw.
ENUMERATED = 6
WEIGHT_DRAWS = 4000
_SINGULAR = 1e-10


def cone_maximum(
    score: Array, information: Array, bounded: NDArray[np.bool_]
) -> tuple[Array, Array, NDArray[np.int_]]:
    """Gain (n,), maximiser (n, q) and number of free parameters (n,) for scores (n, q).

    information: (q, q), positive semidefinite, the scores in its range; where it is singular the maximiser
    with the fewest parameters (bounded) or the shortest (free) is given.
    """
    free, held = np.nonzero(~bounded)[0], np.nonzero(bounded)[0]
    inverse, rank = _pseudo_inverse(information[np.ix_(free, free)])
    coupling = information[np.ix_(held, free)] @ inverse
    reduced = score[:, held] - score[:, free] @ coupling.T
    schur = information[np.ix_(held, held)] - coupling @ information[np.ix_(free, held)]
    gain, positive, active = _orthant_maximum(reduced, schur)
    estimate = np.empty_like(score, dtype=float)
    estimate[:, held] = positive
    estimate[:, free] = (score[:, free] - positive @ information[np.ix_(held, free)]) @ inverse
    gain = gain + np.einsum("na,ab,nb->n", score[:, free], inverse, score[:, free])
    return np.maximum(gain, 0.0), estimate, active + rank


def cone_weights(information: Array, bounded: NDArray[np.bool_], generator: np.random.Generator) -> Array:
    """(q + 1,) probability under the null that 0 .. q parameters are free.

    Exact with at most one bounded parameter, else the frequency in WEIGHT_DRAWS simulated scores.
    """
    count = len(bounded)
    weights = np.zeros(count + 1)
    if bounded.sum() <= 1:
        # Either sign of the one bounded score is as likely as the other.
        _, full = _pseudo_inverse(information)
        if not bounded.any():
            weights[full] = 1.0
            return weights
        _, without = _pseudo_inverse(information[np.ix_(~bounded, ~bounded)])
        weights[full] += 0.5
        weights[without] += 0.5
        return weights
    values, vectors = np.linalg.eigh(information)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = generator.standard_normal((WEIGHT_DRAWS, count)) @ root.T
    _, _, dimension = cone_maximum(draws, information, bounded)
    return np.bincount(dimension, minlength=count + 1) / WEIGHT_DRAWS


def mixture_p_value(gain: Array, weights: Array) -> Array:
    """P(chi-bar-square >= gain) for gains of any shape; 1 where the gain is 0."""
    gain = np.asarray(gain, dtype=float)
    tail = sum(w * chi2.sf(gain, k) for k, w in enumerate(weights) if k and w)
    return np.where(gain > 0.0, tail, 1.0)


def mixture_p_value_of_share(share: Array, weights: Array, degrees: int) -> Array:
    """The same for gain / chi-square of the residual, when sigma is unknown; degrees = N - p.

    Share of a chi-square of k in one of `degrees` is Beta(k/2, (degrees - k)/2); without bounds this is the F
    test ((S/q) / ((rᵀPr - S)/(N - p - q))).
    """
    share = np.asarray(share, dtype=float)
    tail = sum(w * beta.sf(share, k / 2, (degrees - k) / 2) for k, w in enumerate(weights) if k and w)
    return np.where(share > 0.0, tail, 1.0)


def _pseudo_inverse(matrix: Array) -> tuple[Array, int]:
    values, vectors = np.linalg.eigh(matrix)
    kept = values > _SINGULAR * max(float(values.max(initial=0.0)), np.finfo(float).tiny)
    return (vectors[:, kept] / values[kept]) @ vectors[:, kept].T, int(kept.sum())


def _orthant_maximum(score: Array, information: Array) -> tuple[Array, Array, NDArray[np.int_]]:
    """As cone_maximum with every parameter bounded."""
    draws, count = score.shape
    gain, active = np.zeros(draws), np.zeros(draws, dtype=int)
    estimate = np.zeros((draws, count))
    scale = float(np.diag(information).max(initial=0.0))
    if scale <= 0.0:
        return gain, estimate, active
    if count > ENUMERATED:
        return _orthant_maximum_by_rows(score, information)
    # The maximum is the unbounded one of some subset; any subset whose own maximum is positive is a lower
    # bound.
    for size in range(1, count + 1):
        for subset in combinations(range(count), size):
            chosen = list(subset)
            block = information[np.ix_(chosen, chosen)]
            if np.linalg.eigvalsh(block)[0] <= _SINGULAR * scale:
                continue
            values = np.linalg.solve(block, score[:, chosen].T).T
            reached = (score[:, chosen] * values).sum(1)
            better = (values >= 0.0).all(1) & (reached > gain)
            gain[better], active[better] = reached[better], size
            rows = np.zeros((int(better.sum()), count))
            rows[:, chosen] = values[better]
            estimate[better] = rows
    return gain, estimate, active


def _orthant_maximum_by_rows(score: Array, information: Array) -> tuple[Array, Array, NDArray[np.int_]]:
    values, vectors = np.linalg.eigh(information)
    kept = values > _SINGULAR * values.max()
    root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    targets = score @ (vectors[:, kept] / np.sqrt(values[kept]))
    estimate = np.array([nnls(root, target)[0] for target in targets]).reshape(score.shape)
    gain = 2.0 * (score * estimate).sum(1) - np.einsum("na,ab,nb->n", estimate, information, estimate)
    return np.maximum(gain, 0.0), estimate, (estimate > 0.0).sum(1)
