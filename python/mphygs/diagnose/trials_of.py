"""Finite trials of threshold effects: walls that the prediction passes through, yields that it exceeds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor

DIRECTIONS = 200
YIELD_SHARES = (0.8, 0.6, 0.4, 0.25, 0.12)


@dataclass(frozen=True, eq=False)
class Trial:
    """A belief with a threshold effect at a finite value. label: what was tried."""

    effect: str
    label: str
    belief: Belief


def sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread evenly (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + 5.0**0.5) * k
    ring = np.sqrt(1.0 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def contact_trials(
    belief: Belief, predicted: np.ndarray, measured: np.ndarray, sigma: float, *, count: int = 6
) -> list[Trial]:
    """Planes that no measured marker ever passed but the prediction does, the most violated first.

    predicted, measured: (T, M, 3) [m], NaN where missing; sigma: of a coordinate [m].
    """
    if "contact" in belief.effects:
        return []
    seen = np.isfinite(measured).all(-1)
    points, expected = measured[seen], predicted[seen]
    misfit = points - expected
    proposals = []
    for n in sphere(DIRECTIONS):
        limit = float(np.min(points @ n))
        depth = np.maximum(limit - 3.0 * sigma - expected @ n, 0.0)
        if not np.any(depth > 0):
            continue
        # What a wall along n would explain: misfit that points out of it, where the prediction is behind it.
        gain = float(np.sum(np.minimum(depth, np.maximum(misfit @ n, 0.0)) ** 2))
        proposals.append((gain, limit, n))
    proposals.sort(key=lambda item: -item[0])
    chosen: list[tuple[float, float, np.ndarray]] = []
    for proposal in proposals:
        if all(proposal[2] @ other[2] < 0.94 for other in chosen):
            chosen.append(proposal)
        if len(chosen) == count:
            break
    trials = []
    for _, limit, n in chosen:
        values = {
            "d": limit - 2.0 * sigma,
            "n_x": float(n[0]),
            "n_y": float(n[1]),
            "n_z": float(n[2]),
            "mu": 0.2,
        }
        extended = belief.with_effect("contact", values)
        # The plane has three numbers: the largest component of n stays, the others and d are fitted.
        for k, a in enumerate("xyz"):
            if k != int(np.abs(n).argmax()):
                extended = extended.with_parameter(
                    f"contact.n_{a}", free=True, scale=0.1, prior_mean=float(n[k]), prior_std=0.5
                )
        extended = extended.with_parameter("contact.mu", prior_mean=0.3, prior_std=0.5)
        trials.append(
            Trial("contact", "plane n = ({:.2f}, {:.2f}, {:.2f}), d = {:.4f} m".format(*n, limit), extended)
        )
    return trials


def largest_shear_stress(predictor: Predictor, belief: Belief, last: int) -> float:
    """Largest von Mises stress of the base law at any quadrature point and output frame [Pa]."""
    return float(np.quantile(predictor.von_mises(belief, last), 0.999))


def plasticity_trials(predictor: Predictor, belief: Belief, last: int) -> list[Trial]:
    """Yield stresses below the largest stress that the fitted elastic model reaches."""
    if "plasticity" in belief.effects:
        return []
    top = largest_shear_stress(predictor, belief, last)
    trials = []
    for share in YIELD_SHARES:
        extended = belief.with_effect("plasticity", {"yield_stress": share * top})
        extended = extended.with_parameter(
            "plasticity.yield_stress", prior_mean=float(np.log(share * top)), prior_std=2.0
        )
        trials.append(Trial("plasticity", f"yield stress {share * top:.4g} Pa", extended))
    return trials
