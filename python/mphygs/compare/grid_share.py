"""What of a misfit is the grid's: the change under refinement, less what a fit absorbs of it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mphygs.compare.allowance import Allowance, modulated_directions
from mphygs.compare.compared import Compared, Whitened, whiten_all

# How far a coordinate that the fitted frames leave open gives way to the discretisation's error: a factor e.
GIVES_WAY = 1.0
# Cosines over time by which the discretisation's error may differ from the change under refinement.
MODULATIONS = 6


def discretisation_allowance(whitened: Whitened) -> Allowance:
    """Nuisance directions with the size of the change under refinement, per sequence and part."""
    if not np.any(whitened.refinement):
        return Allowance()
    columns = []
    for number in range(len(whitened.names)):
        mine = whitened.sequence == number
        block = modulated_directions(
            whitened.refinement[mine], whitened.part[mine], whitened.frame[mine], count=MODULATIONS
        )
        full = np.zeros((len(mine), block.shape[1]))
        full[mine] = block
        columns.append(full)
    directions = np.concatenate(columns, axis=1)
    return Allowance(directions=directions[:, np.linalg.norm(directions, axis=0) > 1e-9])


def grid_share(whitened: Whitened) -> np.ndarray:
    """(N,) the change under refinement less what refitting absorbs: a fit to the fitted frames, which carries
    what it made of them on to the unseen ones."""
    share, count = whitened.refinement, whitened.jacobian.shape[1]
    if not np.any(share) or not count or not whitened.fitted.any():
        return share
    return share - whitened.jacobian @ _shift(whitened, np.eye(count) / GIVES_WAY**2)


def _shift(whitened: Whitened, prior: np.ndarray) -> np.ndarray:
    """(P,) how far a fit to the fitted frames moves its coordinates for what a refinement changes there.

    prior: (P, P) inverse covariance of the coordinates before anything was measured.
    """
    jacobian = whitened.jacobian[whitened.fitted]
    inverse = np.linalg.pinv(jacobian.T @ jacobian + prior, rcond=1e-14, hermitian=True)
    return inverse @ (jacobian.T @ whitened.refinement[whitened.fitted])


def grid_shift(compared: Mapping[str, Compared], prior: np.ndarray) -> np.ndarray | None:
    """(P,) how far the grid's error moves the fitted coordinates; None where no refinement is known.

    prior: (P, P) inverse covariance of the coordinates before anything was measured. The error of the fitted
    frames is taken for what a refinement changes, extrapolated; what would fit it is found by the tangents of
    the comparison alone, which may be of another grid than those of the fit.
    """
    whitened = whiten_all(compared)
    if not np.any(whitened.refinement) or whitened.jacobian.shape[1] != len(prior):
        return None
    return _shift(whitened, prior)


def error_budget(whitened: Whitened, share: np.ndarray) -> dict[str, float]:
    """Root mean squares over markers of the three shares [m]: they add in squares to the markers' misfit.

    What neither the discretisation's share, (N,), nor noise covers is physics.
    """
    markers = whitened.part >= 0
    variance = whitened.sigma[markers] ** 2
    noise = float(np.mean(variance))
    beyond = max(float(np.mean(variance * whitened.residual[markers] ** 2)) - noise, 0.0)
    discretisation = min(float(np.mean(variance * share[markers] ** 2)), beyond)
    shares = {"noise": noise, "discretisation": discretisation, "physics": beyond - discretisation}
    return {name: float(np.sqrt(3.0 * value)) for name, value in shares.items()}
