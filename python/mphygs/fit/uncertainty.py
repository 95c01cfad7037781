"""How sure a fit's numbers are: by the noise, by what the model leaves of it, and by the grid.

The inverse of the normal matrix is the noise's share alone. Where a model leaves more than the noise, what
it leaves counts as noise: the residual variance scales the covariance (Seber & Wild, "Nonlinear
regression", 1989, section 2.1.2), and what lasts in the residual, or is shared by markers, widens it
(`mphygs.fit.residual_correlation`).

A grid bends numbers. Its error is told by the change from another one (Richardson extrapolation): from a
coarser one that the fit came by, from a finer one where it had no other. At the edge of a hold the stress is
singular, and there, as where boundaries cut cells, no scheme without a graded grid is of its full order
(Szabo & Babuska, "Finite element analysis", 1991, chapter 10): from the default grid to its neighbours
predictions change as those of a first-order scheme do, and that is the order that is counted on. The change
is told in two ways, which do not see the same: by how far the fit's numbers moved between its grids, and by
how far an error of the size of the prediction's change, but of another course in time, would move them.

What is counted is the distance from what an ever finer grid would give. A truth that was itself simulated on
a grid, as that of `mphygs synth` by default on one of 0.62 of the spacing, has part of that error as well:
its numbers are nearer than the standard errors say. Truths of finite elements have none of it
(`benchmarks/standard_errors`).
"""

from __future__ import annotations

import numpy as np

from mphygs.compare.allowance import modulated_directions
from mphygs.compare.grid_share import MODULATIONS
from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.residual_correlation import widened_by_correlation
from mphygs.model.belief import Belief

# Order of convergence that the error of a grid is extrapolated by.
ORDER = 1.0


def coordinate_covariance(
    problem: Problem,
    evaluation: Evaluation,
    grid: np.ndarray | None = None,
    change: np.ndarray | None = None,
) -> np.ndarray:
    """Covariance of the free coordinates at a minimum, (P, P).

    grid: see `grid_change`; change: (N,) error of the grid in the measured rows, see `prediction_change`.
    """
    inverse = covariance(evaluation)
    spread = inverse * max(evaluation.misfit, 1.0) ** 2 + widened_by_correlation(problem, evaluation, inverse)
    if grid is not None:
        spread = spread + np.outer(grid, grid)
    if change is not None:
        moved = grid_moves(problem, evaluation, change, inverse)
        spread = spread + moved @ moved.T
    return spread


def prediction_change(evaluation: Evaluation, other: Evaluation, ratio: float) -> np.ndarray:
    """(N,) error of the grid in the measured rows, from the prediction of the same belief on another one.

    ratio: of the other spacing to this one. Raises ValueError for other rows, and for a ratio of 1.
    """
    if other.data_rows != evaluation.data_rows:
        raise ValueError(f"{other.data_rows} rows on the other grid; expected {evaluation.data_rows}")
    rows = slice(evaluation.data_rows)
    return (evaluation.residual[rows] - other.residual[rows]) * extrapolation(ratio)


def grid_directions(problem: Problem, evaluation: Evaluation, change: np.ndarray) -> np.ndarray:
    """(N, K) errors of the size of a grid's that drift in time, of random amplitude, in the measured rows.

    Of markers: with instruments the grid's share counts as noise. change: (N,) error of the grid in them.
    """
    found = []
    for name, rows in evaluation.rows.items():
        if not np.any(change[rows]):
            continue
        whitener = problem.whitener(name)
        part = problem.predictors[name].attachment.part[whitener.marker]
        own = modulated_directions(change[rows], part, whitener.frame, count=MODULATIONS)
        found.append(np.zeros((evaluation.data_rows, own.shape[1])))
        found[-1][rows] = own
    return np.concatenate(found, axis=1) if found else np.zeros((evaluation.data_rows, 0))


def grid_moves(
    problem: Problem, evaluation: Evaluation, change: np.ndarray, inverse: np.ndarray
) -> np.ndarray:
    """(P, K) how far the coordinates would be moved by errors of the size of a grid's that drift in time.

    change: (N,) error of the grid in the measured rows; inverse: (P, P) of the normal matrix.
    """
    directions = grid_directions(problem, evaluation, change)
    return inverse @ (evaluation.jacobian[: evaluation.data_rows].T @ directions)


def extrapolation(ratio: float) -> float:
    """A grid's error over the change from another one, of so many times its spacing. Raises ValueError for a
    ratio of 1, and of zero or less."""
    if ratio <= 0.0 or ratio == 1.0:
        raise ValueError(f"ratio of spacings {ratio:g}; expected another than 1, above 0")
    return 1.0 / (ratio**ORDER - 1.0)


def grid_change(coarse: Belief, fine: Belief, ratio: float) -> np.ndarray:
    """(P,) how far the free coordinates are from where an ever finer grid would lead: their change from a
    coarser grid, extrapolated. ratio: of the spacings, above 1; what stood at a bound, or is new, says
    nothing. Raises ValueError for a ratio of 1, and of zero or less.
    """
    share = extrapolation(ratio)
    before = {p.key: p for p in coarse.free}
    return np.array(
        [
            (p.coordinate - before[p.key].coordinate) * share
            if p.key in before and not (p.at_bound or before[p.key].at_bound)
            else 0.0
            for p in fine.free
        ]
    )
