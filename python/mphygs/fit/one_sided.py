"""A number that shows on one side alone is found out: a body that hardly deforms is at least as stiff as
would show, a stop that lets nothing pass at least as hard.

The curvature at a minimum is no proof that a stiffness is seen. Small vibrations of a stiff body pass from
one phase to the next as it grows stiffer, and noise makes a minimum of one of them that is as narrow as it is
accidental. So the likelihood is looked at over decades: a number is determined where it falls on both sides.
All other free numbers may follow within their priors, to first order, and so may the error of the grid
within its size, which its change from a coarser one tells: an elasticity that is smaller than what the grid
makes up is not seen. Both are integrated out of the likelihood as directions with a random amplitude.

So are looked at every stiffness, and how much there is of every effect in the model. Where the motion goes by
leaps the curvature is none at all: there steps of the size of the standard errors that it promises do not
change the motion by so many.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mphygs.fit.determined import reference_std
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.limits import FAR, Limits
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.schedule import COARSER
from mphygs.fit.spacings import screening_spacing
from mphygs.fit.uncertainty import grid_directions, prediction_change
from mphygs.model.belief import Belief, Parameter
from mphygs.model.registry import effect
from mphygs.simulate.errors import SimulationError

# Rise of chi^2 that excludes less of a number: three standard deviations. A body as good as rigid is excluded
# by five: the best of many stiffnesses was chosen.
EXCLUDED, SEEN = 9.0, 25.0
# Factors by which a number is moved either way, and halvings of the step in which the limit lies.
SOFTER, STIFFER, HALVINGS = (1.0 / 3.0, 0.1, 0.01, 0.001), (3.0, 10.0, 100.0), 4
# A response so small that the noise, so many times the standard deviation of chi^2, could hide that its phase
# is wrong: the vibrations next to it are tried, at these shares of a turn.
HIDDEN, TURNS = 3.0, (0.5, 0.625, 0.75, 0.875, 1.0, 1.125, 1.25)
# A factor that changes chi^2 by less than this at most, and by less than the one before, ends the search.
NOTHING = 1.0
# Standard deviations by which the best known direction is moved to see whether its derivative holds, and the
# share of the change that it promises that has to come of it.
PROBED, HOLDS = 5.0, 0.35
# A run so many times as long as that at the minimum is not made.
LONGEST = 30.0
# The roles of an effect's numbers that say how much there is of it, or when it sets in.
AMOUNTS = ("strength", "level")


def limits_of(
    problem: Problem,
    belief: Belief,
    evaluation: Evaluation,
    change: np.ndarray | None = None,
    report: Callable[[str], None] | None = None,
) -> dict[str, Limits]:
    """By key, how far each free Young's modulus, and each amount of an effect, can be moved; of all free
    numbers, where the motion goes by leaps.

    evaluation: of the belief, at its minimum, with Jacobian; change: (N,) error of the grid in the measured
    rows (see `coarser_change`), None where it is not known; report: told each number before it is moved. What
    cannot be simulated does not fit, on the
    side of less; on that of more it says nothing. None are told of a model that leaves far more than noise:
    what it lacks would be taken for a bound.
    """
    amounts = amounts_of(belief)
    if not amounts or evaluation.misfit > FAR:
        return {}
    leaps = not derivatives_hold(problem, belief, evaluation)
    grid = [] if change is None else [grid_directions(problem, evaluation, change)]
    reference = np.array([reference_std(p) for p in belief.free])
    measured = evaluation.jacobian[: evaluation.data_rows] * reference
    std = np.sqrt(np.maximum(np.diag(covariance(evaluation)), 0.0))
    found = {p.key: Limits(None, None, leaps=True) for p in belief.free} if leaps else {}
    for index, p in enumerate(belief.free):
        if p in amounts:
            if report:
                report(f"how far {p.key} can be moved ({amounts.index(p) + 1} of {len(amounts)})")
            others = [np.delete(measured, index, axis=1)] if not leaps else []
            directions = np.concatenate([measured[:, :0], *others, *grid], axis=1)
            search = _Search(problem, belief, p, _Likelihood(directions), evaluation, float(std[index]))
            found[p.key] = search.limits(leaps)
    return found


def amounts_of(belief: Belief) -> list[Parameter]:
    """The free numbers whose limits are looked for in any case."""
    return [p for p in belief.free if _is_amount(p)]


def derivatives_hold(problem: Problem, belief: Belief, evaluation: Evaluation) -> bool:
    """Whether a step along the direction that the data know best, as they promise, changes the motion as
    promised, about; also where it cannot be simulated, or is no small step.

    evaluation: of the belief, with Jacobian.
    """
    rows = evaluation.data_rows
    reference = np.array([reference_std(p) for p in belief.free])
    _, values, directions = np.linalg.svd(evaluation.jacobian[:rows] * reference, full_matrices=False)
    if not len(values) or values[0] < PROBED:
        return True
    step = reference * directions[0] * PROBED / values[0]
    moved = []
    for way in (step, -step):
        there = belief.at(belief.coordinates + way)
        if np.array_equal(there.coordinates, belief.coordinates):
            continue
        try:
            left = problem.evaluate(there, jacobian=False).residual[:rows]
        except SimulationError:
            continue
        promised = evaluation.jacobian[:rows] @ (there.coordinates - belief.coordinates)
        change = left - evaluation.residual[:rows]
        moved.append(float(change @ change) / max(float(promised @ promised), 1e-300))
    return not moved or float(np.mean(moved)) > HOLDS**2


def coarser_change(
    experiment: Experiment, belief: Belief, evaluation: Evaluation, spacing: float
) -> np.ndarray | None:
    """(N,) error of a grid of `spacing` [m] in the measured rows, by the prediction on a coarser one; None
    where that cannot carry the belief. evaluation: of the belief on the grid."""
    coarser = max(screening_spacing(experiment.capture), COARSER * spacing)
    try:
        coarse = experiment.problem(coarser).evaluate(belief, jacobian=False)
    except SimulationError:
        return None
    return prediction_change(evaluation, coarse, coarser / spacing)


def _is_amount(p: Parameter) -> bool:
    """Whether a number is a stiffness, or says how much there is of an effect in the motion."""
    owner, name = p.key.rsplit(".", 1)
    if name == "youngs_modulus":
        return True
    try:
        spec = effect(owner)
    except KeyError:  # a part, or a sequence
        return False
    return not spec.fault and any(own.name == name for role in AMOUNTS for own in spec.of_role(role))


def _null_of(p: Parameter) -> float:
    """Where there is nothing of a number."""
    if p.log:
        return 0.0
    owner, name = p.key.rsplit(".", 1)
    return next(own.null for own in effect(owner).parameters if own.name == name)


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
    """For the factors on one number that are excluded. evaluation: at the factor of one; std: of its
    coordinate, by the noise."""

    problem: Problem
    belief: Belief
    parameter: Parameter
    likelihood: _Likelihood
    evaluation: Evaluation
    std: float

    def limits(self, leaps: bool) -> Limits:
        """leaps: whether the motion goes by leaps, and has no derivatives."""
        own, stiff = self.parameter, self._first(STIFFER)
        told = not own.log and stiff is not None and not leaps  # by its standard error, however little it is
        soft = None if told else self._first(SOFTER)
        found = Limits(
            soft and soft[1], stiff and stiff[1], leaps=leaps, weak=not own.log, null=_null_of(own)
        )
        if found.seen and own.key.endswith(".youngs_modulus"):
            return replace(found, phases=self._other_phases(found.stiff))
        if found.seen or not found.one_sided:
            return found
        inside, outside = soft or stiff
        for _ in range(HALVINGS):
            middle = float(np.sqrt(inside * outside))
            if self._excluded(middle, self._residual(middle)):
                outside = middle
            else:
                inside = middle
        return replace(found, soft=soft and outside, stiff=stiff and outside)

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
        index = [p.key for p in self.belief.free].index(self.parameter.key)
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

    def _value(self, factor: float) -> float:
        """The number at a factor. One that is next to nothing is moved by what its error would hide: there a
        factor says nothing."""
        own, null = self.parameter, _null_of(self.parameter)
        if own.log:
            return own.value * factor
        amount = own.value - null
        least = PROBED * self.std * own.scale
        if factor > 1.0 and abs(amount) < least:
            amount = float(np.copysign(least, amount))
        return null + factor * amount

    def _residual(self, factor: float) -> np.ndarray | None:
        """(N,) of the measured rows, None where the factor cannot be simulated, or by too long a run."""
        own, value = self.parameter, self._value(factor)
        if own.key.endswith(".youngs_modulus"):
            reach = {"lower": min(own.lower, value), "upper": max(own.upper, value)}
        else:
            value, reach = float(np.clip(value, own.lower, own.upper)), {}
        trial = self.belief.with_parameter(own.key, value=value, **reach)
        try:
            if self.problem.stable_substep(trial) * LONGEST < self.problem.stable_substep(self.belief):
                return None
            return self.problem.evaluate(trial, jacobian=False).residual[: self.evaluation.data_rows]
        except SimulationError:
            return None
