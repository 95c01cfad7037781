"""A stiffness that shows on one side alone is told as a bound: a body that hardly deforms is at least as
stiff as would show.

The curvature at a minimum is no proof that a stiffness is seen. Small vibrations of a stiff body pass from
one phase to the next as it grows stiffer, and noise makes a minimum of one of them that is as narrow as it is
accidental. So the likelihood is looked at over decades: a stiffness is determined where it falls on both
sides. All other free numbers may follow within their priors, to first order, and so may the error of the grid
within its size, which its change from a coarser one tells: an elasticity that is smaller than what the grid
makes up is not seen. Both are integrated out of the likelihood as directions with a random amplitude.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mphygs.fit.determined import SAYS_NOTHING, reference_std
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.run import Run
from mphygs.fit.uncertainty import grid_directions, prediction_change
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Rise of chi^2 that excludes a softer body: three standard deviations. A body as good as rigid is excluded
# by five: the best of many stiffnesses was chosen.
EXCLUDED, SEEN = 9.0, 25.0
# Factors by which a stiffness is moved either way, and halvings of the step in which the limit lies.
SOFTER, STIFFER, HALVINGS = (1.0 / 3.0, 0.1, 0.01, 0.001), (3.0, 10.0, 100.0), 4
# A response so small that the noise, so many times the standard deviation of chi^2, could hide that its phase
# is wrong: the vibrations next to it are tried, at these shares of a turn.
HIDDEN, TURNS = 3.0, (0.5, 0.625, 0.75, 0.875, 1.0, 1.125, 1.25)
# A factor that changes chi^2 by less than this at most, and by less than the one before, ends the search.
NOTHING = 1.0


@dataclass(frozen=True)
class Limits:
    """Factors nearest to 1 that are excluded, on either side; None where none is. phases: whether vibrations
    of other phases, at stiffnesses between them, fit as well."""

    soft: float | None
    stiff: float | None
    phases: bool = False

    @property
    def one_sided(self) -> bool:
        """Whether one side is excluded, and not the other."""
        return (self.soft is None) != (self.stiff is None)

    @property
    def seen(self) -> bool:
        """Whether both are, and nothing between them fits as well."""
        return self.soft is not None and self.stiff is not None and not self.phases

    def bound(self, value: float) -> dict[str, float]:
        """{"lower": ...}, {"upper": ...} or both of a stiffness that is not seen, in its unit."""
        if self.seen:
            return {}
        found = {"lower": self.soft, "upper": self.stiff}
        return {side: value * factor for side, factor in found.items() if factor is not None}

    def words(self, value: float, unit: str) -> str:
        """The same as a remark, "" where there is no bound."""
        bound = self.bound(value)
        if len(bound) == 2:
            ends = " and ".join(f"{end:.2g}" for end in bound.values())
            return f"between {ends} {unit}: vibrations of several phases fit as well"
        for side, end in bound.items():
            lower = side == "lower"
            much = "softer would move more" if lower else "stiffer would move less"
            return f"{'at least' if lower else 'at most'} {end:.2g} {unit}: what is {much} than is seen"
        return ""


def limits_of(
    problem: Problem, belief: Belief, evaluation: Evaluation, change: np.ndarray | None = None
) -> dict[str, Limits]:
    """By key, how far each free Young's modulus can be moved.

    evaluation: of the belief, at its minimum, with Jacobian; change: (N,) error of the grid in the measured
    rows (see `prediction_change`), None where it is not known. What cannot be simulated does not fit, on the
    soft side; on the stiff side it says nothing.
    """
    grid = [] if change is None else [grid_directions(problem, evaluation, change)]
    reference = np.array([reference_std(p) for p in belief.free])
    measured = evaluation.jacobian[: evaluation.data_rows] * reference
    found = {}
    for index, p in enumerate(belief.free):
        if p.key.endswith(".youngs_modulus"):
            others = np.concatenate([np.delete(measured, index, axis=1), *grid], axis=1)
            found[p.key] = _Search(problem, belief, p.key, _Likelihood(others), evaluation).limits()
    return found


def coarser_change(state: Run, experiment: Experiment, evaluation: Evaluation) -> np.ndarray | None:
    """(N,) error of a finished fit's grid in the measured rows, by the grid of the stage before; None where
    that was no coarser, or cannot carry the belief. evaluation: of its belief."""
    spacings = [record.spacing for record in state.history[-2:]]
    if len(spacings) < 2 or spacings[0] <= spacings[1]:
        return None
    try:
        coarse = experiment.problem(spacings[0]).evaluate(state.belief, jacobian=False)
    except SimulationError:
        return None
    return prediction_change(evaluation, coarse, spacings[0] / spacings[1])


def with_limits(
    state: Run, limits: Mapping[str, Limits], parameters: Mapping[str, Mapping[str, object]]
) -> Run:
    """A finished fit that knows as little of a stiffness that is not seen on both sides as before it.

    parameters: as the fit tells them; what it tells as not determined stays as it is.
    """
    covariance, information = state.covariance.copy(), state.information.copy()
    for index, p in enumerate(state.belief.free):
        if p.key not in limits or limits[p.key].seen or not parameters[p.key]["determined"]:
            continue
        wide = reference_std(p) / np.sqrt(max(covariance[index, index], 1e-300))
        covariance[index] *= max(wide, 1.0)
        covariance[:, index] *= max(wide, 1.0)
        information[index], information[:, index] = 0.0, 0.0
    return replace(state, covariance=covariance, information=information)


def with_bounds(
    parameters: Mapping[str, Mapping[str, object]], limits: Mapping[str, Limits]
) -> dict[str, dict[str, object]]:
    """The parameters that are not determined with their bounds, and a note that says them."""
    told = {key: dict(entry) for key, entry in parameters.items()}
    for key, entry in told.items():
        if key not in limits or entry["determined"]:
            continue
        if note := limits[key].words(entry["value"], entry["unit"]):
            said = str(entry.get("note", "")).replace(SAYS_NOTHING, "")
            entry["bound"] = limits[key].bound(entry["value"])
            entry["note"] = f"{said}; {note}".lstrip("; ")
    return told


class _Likelihood:
    """Of residuals with noise of one, and with directions (N, K) whose amplitudes are normal numbers."""

    def __init__(self, directions: np.ndarray) -> None:
        self._directions = directions
        self._factor = cho_factor(np.eye(directions.shape[1]) + directions.T @ directions)

    def chi_square(self, residual: np.ndarray) -> float:
        """Minus twice the logarithm, but for a constant."""
        along = self._directions.T @ residual
        return float(residual @ residual - along @ cho_solve(self._factor, along))


@dataclass(frozen=True, eq=False)
class _Search:
    """For the factors on one stiffness that are excluded. evaluation: at the factor of one."""

    problem: Problem
    belief: Belief
    key: str
    likelihood: _Likelihood
    evaluation: Evaluation

    def limits(self) -> Limits:
        soft, stiff = self._first(SOFTER), self._first(STIFFER)
        found = Limits(soft and soft[1], stiff and stiff[1])
        if found.seen:
            return replace(found, phases=self._other_phases(found.stiff))
        if not found.one_sided:
            return found
        inside, outside = soft or stiff
        for _ in range(HALVINGS):
            middle = float(np.sqrt(inside * outside))
            if self._excluded(middle, self._residual(middle)):
                outside = middle
            else:
                inside = middle
        return Limits(soft and outside, stiff and outside)

    def _first(self, factors: Sequence[float]) -> tuple[float, float] | None:
        """The first factor that is excluded, with the one before it; None where none is."""
        inside, before, moved = 1.0, self.evaluation.residual[: self.evaluation.data_rows], 0.0
        for factor in factors:
            left = self._residual(factor)
            if self._excluded(factor, left):
                return inside, factor
            if left is None:
                return None
            last, moved = moved, float(((left - before) ** 2).sum())
            if moved < min(NOTHING, last):
                return None
            inside, before = factor, left
        return None

    def _other_phases(self, stiff: float) -> bool:
        """Whether a vibration a turn away fits as well. stiff: factor whose response is another one."""
        rows = self.evaluation.data_rows
        index = [p.key for p in self.belief.free].index(self.key)
        slope, here = self.evaluation.jacobian[:rows, index], self.evaluation.residual[:rows]
        left = self._residual(stiff)
        if left is None:
            return False
        size = float(((left - here) ** 2).sum())
        turn = 2.0 * np.pi * np.sqrt(size / max(float(slope @ slope), 1e-300))
        if turn > np.log(stiff) or size > HIDDEN * np.sqrt(2.0 * rows):
            return False
        factors = np.exp(turn * np.r_[TURNS, -np.array(TURNS)])
        return not all(self._excluded(min(f, 1.0 / f), self._residual(f)) for f in factors)

    def _excluded(self, factor: float, left: np.ndarray | None) -> bool:
        if left is None:
            return factor < 1.0
        least = self.likelihood.chi_square(self.evaluation.residual[: self.evaluation.data_rows])
        return self.likelihood.chi_square(left) - least > (EXCLUDED if factor < 1.0 else SEEN)

    def _residual(self, factor: float) -> np.ndarray | None:
        """(N,) of the measured rows, None where the factor cannot be simulated."""
        own = self.belief[self.key]
        value = own.value * factor
        reach = {"lower": min(own.lower, value), "upper": max(own.upper, value)}
        trial = self.belief.with_parameter(self.key, value=value, **reach)
        try:
            return self.problem.evaluate(trial, jacobian=False).residual[: self.evaluation.data_rows]
        except SimulationError:
            return None
