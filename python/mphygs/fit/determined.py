"""What the data determine, and what they leave to the priors.

The posterior covariance of the fitted coordinates is compared with the prior one, direction by direction:
in the generalised eigenproblem C_posterior d = lambda C_prior d, lambda is the share of the prior's variance
that the data left (Spantini et al., "Optimal low-rank approximations of Bayesian linear inverse problems",
SIAM J. Sci. Comput. 37, 2015).

That is what noise leaves. The grid, errors that last and what the model lacks bend a number as well; where
they leave more of it open than noise does, the same share decides of the number by itself.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mphygs.fit.problem import Evaluation
from mphygs.model.belief import Parameter
from mphygs.model.registry import effects

# A direction is undetermined where the posterior's standard deviation is more than half of the prior's.
LARGEST_SHARE = 0.25
# Without a prior: this many usual sizes of the parameter, or its value where that is more, at most half of
# the way between its bounds.
USUAL_SIZES = 10.0
# Priors may decide an uncertainty as long as it is small: 5 % of a logarithm, or of a usual size.
SMALL = 0.05
# Components below this share of a direction's largest are not named.
SMALLEST_COMPONENT = 0.2
# What is noted of a number of which nothing is known.
SAYS_NOTHING = "the data say nothing about it"
BENT = "noise would let it be told, but errors of the grid and of the model leave it open"
# How surely the length of a direction, fitted as a vector of any length, is known to be one.
CERTAIN = 1e-6


@dataclass(frozen=True)
class Determination:
    """std: in the parameter's unit; determined: by the data; note: what is determined instead, or why not."""

    std: float
    determined: bool
    note: str = ""


def reference_std(parameter: Parameter) -> float:
    """Standard deviation of the coordinate before the data: the prior's, or a wide one."""
    if math.isfinite(parameter.prior_std):
        return parameter.prior_std if parameter.log else parameter.prior_std / parameter.scale
    if parameter.log:
        return 3.0
    reach = 0.5 * (parameter.upper - parameter.lower) / parameter.scale
    size = max(USUAL_SIZES, abs(parameter.coordinate))
    return min(size, reach) if math.isfinite(reach) else size


def information_of(evaluation: Evaluation, free_count: int) -> np.ndarray:
    """Fisher information of the measurements, a known mass included, about the free coordinates, (P, P)."""
    rows = evaluation.data_rows
    if evaluation.jacobian.shape[1] != free_count:
        raise ValueError(f"jacobian by {evaluation.jacobian.shape[1]} coordinates; expected {free_count}")
    # The priors' rows stand behind the measured ones, a known mass behind them.
    measured = np.delete(evaluation.jacobian, np.s_[rows : rows + evaluation.prior_rows], axis=0)
    return measured.T @ measured


def determinations(
    free: Sequence[Parameter], information: np.ndarray, covariance: np.ndarray
) -> dict[str, Determination]:
    """By key, how well each free parameter is known.

    information: (P, P) of the measurements alone; covariance: (P, P) of the coordinates, priors included, and
    whatever else leaves them open.
    """
    if not free:
        return {}
    reference = np.array([reference_std(p) for p in free])
    # In units of the prior: along each eigenvector the posterior's precision is 1 + the eigenvalue.
    gain, vectors = np.linalg.eigh(information * np.outer(reference, reference))
    left = 1.0 / (1.0 + np.maximum(gain, 0.0))
    directions = vectors.T * reference  # rows: in coordinates, one prior standard deviation long
    variance = (left[:, None] * directions**2).sum(0)
    poor = left > LARGEST_SHARE
    from_prior = (left[poor, None] * directions[poor] ** 2).sum(0)
    found = {}
    for k, parameter in enumerate(free):
        spread = math.sqrt(max(covariance[k, k], 0.0))
        undetermined = from_prior[k] > 0.5 * variance[k] and math.sqrt(variance[k]) > SMALL
        bent = spread**2 > max(variance[k], LARGEST_SHARE * reference[k] ** 2) and spread > SMALL
        if undetermined:
            # Where neither data nor prior bound it, the pseudo-inverse would say that nothing is known as 0.
            spread = max(spread, math.sqrt(variance[k]))
            note = _note(free, directions[poor], left[poor], k)
        else:
            note = "; ".join(filter(None, [_bound_note(parameter), BENT if bent else ""]))
        found[parameter.key] = Determination(spread * parameter.slope, not (undetermined or bent), note)
    return found


def components(free: Sequence[Parameter]) -> set[str]:
    """Keys of those parameters that are a direction together, all of them free."""
    known = {p.key for p in free}
    return {key for keys in _directions() if known.issuperset(keys) for key in keys}


def _directions() -> list[tuple[str, ...]]:
    """Keys of parameters that are a direction together, whose length does not matter."""
    found = ((name, spec.of_role("direction")) for name, spec in effects().items())
    return [tuple(f"{name}.{p.name}" for p in own) for name, own in found if own]


def of_unit_length(
    free: Sequence[Parameter], information: np.ndarray, covariance: np.ndarray
) -> tuple[list[Parameter], np.ndarray, np.ndarray]:
    """The same with directions, fitted as vectors of any length, as unit vectors whose length is known.

    information, covariance: as for `determinations`.
    """
    free, information, covariance = list(free), information.copy(), covariance.copy()
    place = {p.key: k for k, p in enumerate(free)}
    for keys in _directions():
        at = [place.get(key, -1) for key in keys]
        vector = np.array([free[k].value for k in at if k >= 0])
        length = float(np.linalg.norm(vector))
        if -1 in at or length == 0.0:
            continue
        unit, scale = vector / length, np.array([free[k].scale for k in at])
        across = np.eye(len(free))
        across[np.ix_(at, at)] = (np.eye(3) - np.outer(unit, unit)) * scale / scale[:, None] / length
        covariance = across @ covariance @ across.T
        information[at] *= length
        information[:, at] *= length
        along = unit * scale / CERTAIN
        information[np.ix_(at, at)] += np.outer(along, along)
        for k, value in zip(at, unit, strict=True):
            free[k] = replace(free[k], value=float(value))
    return free, information, covariance


def _bound_note(parameter: Parameter) -> str:
    if parameter.value == parameter.lower and math.isfinite(parameter.lower):
        return f"at its lower bound {parameter.lower:g} {parameter.unit}"
    if parameter.value == parameter.upper and math.isfinite(parameter.upper):
        return f"at its upper bound {parameter.upper:g} {parameter.unit}"
    return ""


def _note(free: Sequence[Parameter], directions: np.ndarray, left: np.ndarray, index: int) -> str:
    """What the data say of a parameter that they do not determine on its own."""
    direction = directions[np.argmax(left * directions[:, index] ** 2)]
    named = np.flatnonzero(np.abs(direction) > SMALLEST_COMPONENT * np.abs(direction).max())
    keys = [free[i].key for i in named]
    if len(named) < 2 or index not in named:
        return SAYS_NOTHING
    same = np.ptp(direction[named]) < 0.3 * np.abs(direction[named]).max()
    if all(free[i].log for i in named) and same:
        if len(named) == 2:
            return f"the data determine {keys[0]} / {keys[1]} only"
        return f"the data determine only the ratios of {', '.join(keys)}"
    if all(free[i].log for i in named) and len(named) == 2:
        power = -direction[named[0]] / direction[named[1]]
        return f"the data determine {keys[0]} * ({keys[1]})^{power:.2g} only"
    return f"the data determine a combination of {', '.join(keys)} only"
