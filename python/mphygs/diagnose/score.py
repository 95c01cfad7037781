"""Score test of candidate effects from their tangents: what each would explain, and is that more than chance.

All arrays are whitened. With P removing what refitting the parameters absorbs, u = jᵀ P r, I = jᵀ P j,
S = uᵀ I⁻¹ u ~ chi²_q under the null, estimate I⁻¹ u (Rao, 1948; with nuisance parameters Neyman, 1959).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.compare.allowance import Allowance
from mphygs.compare.residual_projection import RANK_TOLERANCE, project_out
from mphygs.diagnose.cone import cone_maximum, cone_weights, mixture_p_value, mixture_p_value_of_share
from mphygs.diagnose.score_table import Array, Candidate, Score, ScoreTable

# Above this absorbed share the motion cannot test a candidate.
MAXIMUM_ABSORBED = 0.999


def score_candidates(
    residual: Array,
    jacobian: Array,
    candidates: Sequence[Candidate],
    *,
    generator: np.random.Generator,
    allowance: Allowance | None = None,
    sigma_known: bool = True,
    rank_tolerance: float = RANK_TOLERANCE,
) -> ScoreTable:
    """Score every candidate against the whitened residual.

    residual: (N,) measured minus predicted, at the fitted parameters. jacobian: (N, p) of the prediction,
    without parameters at a bound, prior rows appended to all arrays. generator: for the weights of candidates
    with several bounded parameters. allowance: the discretisation's share. sigma_known: False estimates the
    scale from the residual (F test).
    Raises ValueError on arrays that do not fit together, non-finite numbers, or repeated names.
    """
    _check(residual, jacobian, candidates)
    allowance = allowance or Allowance()
    projection = project_out(allowance.apply_jacobian(jacobian), rank_tolerance=rank_tolerance)
    remaining = projection.remaining(allowance.apply(residual))
    degrees = len(remaining) - projection.rank
    if degrees < 1:
        raise ValueError(f"{len(residual)} observations for {projection.rank} parameters: expected more")
    misfit = _Misfit(float(remaining @ remaining), degrees, len(residual), sigma_known)
    starts = np.cumsum([0, *(c.tangent.shape[1] for c in candidates)])
    tangents = allowance.apply(np.hstack([np.empty((len(residual), 0)), *(c.tangent for c in candidates)]))
    length = np.linalg.norm(tangents, axis=0)
    scale = np.where(length > 0.0, length, 1.0)
    tangents /= scale
    gram = tangents.T @ tangents
    absorbing = projection.absorbing(tangents)[: jacobian.shape[1]]
    left = projection.remaining(tangents)
    information = left.T @ left
    restriction = np.zeros_like(gram)
    blocks = [slice(int(a), int(b)) for a, b in zip(starts[:-1], starts[1:], strict=True)]
    bases = [_testable_directions(gram[b, b], information[b, b], rank_tolerance) for b in blocks]
    for block, (basis, _) in zip(blocks, bases, strict=True):
        restriction[block, block] = gram[block, block] @ basis @ basis.T
    joint_score = restriction @ (left.T @ remaining)
    joint_information = restriction @ information @ restriction.T
    absorbed = np.where(length > 0.0, 1.0 - np.diag(information), 1.0)
    scores = tuple(
        _one_score(
            candidate,
            _Algebra(
                basis,
                best,
                gram[b, b],
                joint_score[b],
                joint_information[b, b],
                scale[b],
                absorbed[b],
                absorbing[:, b],
            ),
            misfit,
            generator,
        )
        for candidate, b, (basis, best) in zip(candidates, blocks, bases, strict=True)
    )
    return ScoreTable(
        scores=scores,
        chi_square=misfit.chi_square,
        degrees=degrees,
        sigma_known=sigma_known,
        joint_score=joint_score,
        joint_information=joint_information,
        starts=starts,
        bounded=np.concatenate([np.zeros(0, bool), *(np.asarray(c.lower_bounded, bool) for c in candidates)]),
        scale=scale,
        index={candidate.name: i for i, candidate in enumerate(candidates)},
    )


def predicted_residual(
    residual: Array, jacobian: Array, tangent: Array, *, increment: Array, shift: Array
) -> Array:
    """Residual (N,) expected once the effect stands at its estimate and the parameters have given way.

    Linear prediction, in whatever unit the arrays are: raw ones [m] give the expected error in metres.
    increment: (q,) estimate minus null. shift: (p,).
    """
    return residual - tangent @ increment - jacobian @ shift


@dataclass(frozen=True)
class _Misfit:
    chi_square: float
    degrees: int
    observations: int
    sigma_known: bool


@dataclass(frozen=True)
class _Algebra:
    """One candidate in units of its columns' lengths; `basis` (q, k) spans the testable directions."""

    basis: Array
    best_retained: float
    gram: Array
    score: Array
    information: Array
    scale: Array
    absorbed: Array
    absorbing: Array


def _check(residual: Array, jacobian: Array, candidates: Sequence[Candidate]) -> None:
    count = len(residual)
    if residual.ndim != 1 or not np.all(np.isfinite(residual)):
        raise ValueError("residual: expected a vector of finite numbers")
    if jacobian.ndim != 2 or len(jacobian) != count:
        raise ValueError(f"Jacobian of shape {jacobian.shape}: expected {count} rows, as the residual")
    names = [candidate.name for candidate in candidates]
    for candidate in candidates:
        if len(candidate.tangent) != count:
            raise ValueError(f"{candidate.name}: tangent of {len(candidate.tangent)} rows, expected {count}")
        if names.count(candidate.name) > 1:
            raise ValueError(f"{candidate.name}: listed twice as a candidate")


def _testable_directions(gram: Array, information: Array, tolerance: float) -> tuple[Array, float]:
    """Directions (q, k), basisᵀ gram basis = 1, absorbed by less than MAXIMUM_ABSORBED; the largest share
    kept.

    gram = jᵀ j and information = jᵀ P j are diagonal together in them.
    """
    values, vectors = np.linalg.eigh(gram)
    kept = values > max(tolerance**2, 1e-14) * max(float(values[-1]), np.finfo(float).tiny)
    orthonormal = vectors[:, kept] / np.sqrt(values[kept])
    retained, rotation = np.linalg.eigh(orthonormal.T @ information @ orthonormal)
    best = float(np.clip(retained.max(initial=0.0), 0.0, 1.0))
    return orthonormal @ rotation[:, retained > 1.0 - MAXIMUM_ABSORBED], best


def _one_score(
    candidate: Candidate, algebra: _Algebra, misfit: _Misfit, generator: np.random.Generator
) -> Score:
    bounded = np.asarray(candidate.lower_bounded, dtype=bool)
    scale, count = algebra.scale, len(algebra.scale)
    testable = algebra.basis.shape[1] > 0
    statistic = drop = 0.0
    p_value, weights = 1.0, np.eye(1, count + 1)[0]
    gained, unbounded = np.zeros(count), np.zeros(count)
    std = np.full(count, np.inf)
    if testable:
        retained = np.einsum("qk,qr,rk->k", algebra.basis, algebra.information, algebra.basis)
        along = algebra.basis.T @ algebra.score
        statistic = float(np.sum(along**2 / retained))
        unbounded = algebra.basis @ (along / retained)
        drops, gains, _ = cone_maximum(algebra.score[None], algebra.information, bounded)
        drop, gained = min(float(drops[0]), statistic), gains[0]
        weights = cone_weights(algebra.information, bounded, generator)
        if misfit.sigma_known:
            p_value = float(mixture_p_value(drop, weights))
        else:
            p_value = float(mixture_p_value_of_share(drop / misfit.chi_square, weights, misfit.degrees))
        # A parameter is determined when it lies wholly in the testable directions.
        outside = np.abs(np.eye(count) - algebra.basis @ algebra.basis.T @ algebra.gram).max(1)
        spread = np.sqrt(np.einsum("qk,k->q", algebra.basis**2, 1.0 / retained))
        std = np.where(outside < 1e-6, spread, np.inf)
        if not misfit.sigma_known:
            rank = algebra.basis.shape[1]
            std = std * np.sqrt(max(misfit.chi_square - statistic, 0.0) / max(misfit.degrees - rank, 1))
    expected = max(misfit.chi_square - drop, 0.0)
    return Score(
        name=candidate.name,
        testable=testable,
        reason="" if testable else _reason(algebra),
        statistic=statistic,
        drop=drop,
        weights=weights,
        p_value=p_value,
        estimate=np.asarray(candidate.null) + gained / scale,
        unbounded=np.asarray(candidate.null) + unbounded / scale,
        std=std / scale,
        score=algebra.score * scale,
        information=algebra.information * np.outer(scale, scale),
        shift=-algebra.absorbing @ gained,
        absorbed=algebra.absorbed,
        absorbed_share=1.0 - algebra.best_retained,
        expected_chi_square=expected,
        expected_rms=float(np.sqrt(expected / misfit.observations)),
    )


def _reason(algebra: _Algebra) -> str:
    if not np.diag(algebra.gram).any():
        return "the prediction does not move with it at its null"
    return f"the fitted parameters absorb {1.0 - algebra.best_retained:.2%} of it"
