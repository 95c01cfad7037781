"""Thresholds tried at finite values: levels that a motion reaches, how much of an effect there is at each.

Where a threshold lies no derivative at the null tells. How much there is beyond it one does: with the level
fixed most effects are smooth in their strengths.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from scipy.optimize import lsq_linear

from mphygs.diagnose.effect_variants import extent, placements, scanned_values, strengths, vector_values
from mphygs.fit.problem import Evaluation, Problem
from mphygs.model.belief import Belief
from mphygs.model.descriptor import EffectSpec, ParameterSpec
from mphygs.simulate.errors import SimulationError

# Of the highest level that the model without the threshold reaches.
SHARES = (0.8, 0.6, 0.4, 0.25, 0.12)
# The quantile that stands for the largest stress: single points at edges say too much.
LARGEST = 0.999
# A strength without a level, and where a level may be that does not say so, times its usual size.
ABOUT = (0.1, 0.3, 1.0, 3.0)
# Of the logarithm of a level that was tried, the standard deviation of its prior.
LEVEL_PRIOR = 2.0
# The highest level is found to this factor; an effect acts there by this share of what all of it does.
KNOWN_TO, ACTS = 1.15, 1e-3
# A sum of squares [sigma^2] that nobody sees.
NOTHING = 1e-2
# So many levels at which an effect promises most are tried, at so many times the strength that it promises:
# what stops a motion has hardly any more effect the stronger it is.
FEW, TIMES = 3, (1.0, 3.0)


def threshold_trials(
    spec: EffectSpec, problem: Problem, belief: Belief, evaluation: Evaluation
) -> list[tuple[str, Belief]]:
    """Finite values of a threshold effect that a belief lacks: what is tried, and the belief with it.

    Levels are shares of the highest one that the problem's first sequence reaches without the effect. A
    stress is measured by von Mises' one and tried above what the object bears at the start, where it carries
    its weight and nothing yields; of another number the highest at which the effect still acts counts. How
    much there is of it a tangent at each level says. Without a level, strengths are tried about their usual
    size. evaluation: of the belief, with Jacobian.
    """
    scan = _Scan(spec, problem, belief, evaluation)
    form = scan.best_form()
    if not scan.levels:
        return scan.sizes(form)
    tried = scan.shares(form)
    if not tried:
        return []
    if not strengths(spec):
        return [(_label(form, scan.levels, values), scan.belief(form, values)) for values in tried]
    responses = [(scan.response(form, values), values) for values in tried]
    promising = [(found, values) for found, values in responses if found is not None and found.drop > 0.0]
    promising.sort(key=lambda item: -item[0].drop)
    return [
        (_label(form, scan.levels, values), scan.belief(form, values | found.strengths(times)))
        for found, values in promising[:FEW]
        for times in TIMES
    ]


def onset_levels(spec: EffectSpec) -> tuple[ParameterSpec, ...]:
    """The levels at which a threshold effect sets in: they are tried where it is not absent, as a time is."""
    return tuple(
        p for p in spec.of_role("level") if p.fitted and not _span(p)[0] <= p.null <= _span(p)[1]
    )


def _span(p: ParameterSpec) -> tuple[float, float]:
    """Where a level may be, from low to high."""
    low, high = p.range
    if low < high:
        return low, high
    return max(p.lower, ABOUT[0] * p.scale), min(p.upper, ABOUT[-1] * p.scale)


@dataclass(frozen=True, eq=False)
class _Form:
    """Where and along what an effect is tried. said: in words, empty where it has no choice."""

    said: str
    values: Mapping[str, float]
    settings: Mapping[str, object]


@dataclass(frozen=True, eq=False)
class _Response:
    """What a model with an effect of no strength changes, and its slopes by the strengths.

    change: (N,) of the prediction; columns: (N, q) by coordinates; bounds: (2, q) of their steps; residual:
    (N,) of the model without it; all less what the fitted numbers absorb. belief: in which
    the strengths are free.
    """

    residual: np.ndarray
    change: np.ndarray
    columns: np.ndarray
    bounds: np.ndarray
    belief: Belief

    @cached_property
    def step(self) -> np.ndarray:
        """(q,) step of the strengths that fits best, within their bounds."""
        size = np.linalg.norm(self.columns, axis=0)
        used = size > 0.0
        found = np.zeros(len(size))
        if used.any():
            scaled = self.bounds[:, used] * size[used]
            left = self.residual - self.change
            found[used] = lsq_linear(self.columns[:, used] / size[used], left, scaled).x / size[used]
        return found

    @property
    def drop(self) -> float:
        """Of the sum of squares, with these strengths."""
        left = self.residual - self.change - self.columns @ self.step
        return float(self.residual @ self.residual - left @ left)

    @property
    def action(self) -> float:
        """How much the effect does: the larger of its change and its slopes, as a sum of squares."""
        return max(float(self.change @ self.change), float((self.columns**2).sum(0).max(initial=0.0)))

    def strengths(self, times: float) -> dict[str, float]:
        """Their values, so many steps from nothing."""
        moved = self.belief.at(self.belief.coordinates + times * self.step)
        return {p.key.rsplit(".", 1)[1]: p.value for p in moved.free}


class _Scan:
    """Runs with an effect over the frames of a problem's first sequence."""

    def __init__(
        self, spec: EffectSpec, problem: Problem, belief: Belief, evaluation: Evaluation
    ) -> None:
        self.spec, self.levels, self._before = spec, onset_levels(spec), belief
        self.name = next(iter(problem.ranges))
        self.problem = problem.with_ranges({self.name: problem.ranges[self.name]})
        self.predictor = self.problem.predictors[self.name]
        rows = evaluation.rows[self.name]
        self._residual, jacobian = evaluation.residual[rows], evaluation.jacobian[rows]
        self._basis = np.linalg.qr(jacobian)[0] if jacobian.shape[1] else np.zeros((len(jacobian), 0))

    def forms(self) -> Iterator[_Form]:
        """Places, directions and further levels at which the effect may be tried."""
        body, anchors = self.predictor.body, self.spec.of_role("anchor")
        for place, settings in placements(body, self.spec, {}):
            tied = vector_values(anchors, np.asarray(settings["place"])) if anchors else {}
            for said, values in scanned_values(body, self.spec, without=self.levels):
                yield _Form(f"{place}{said}".lstrip(" ,"), values | tied, settings)

    def best_form(self) -> _Form:
        """The one that promises most where all of the effect acts that can; the first where none acts."""
        every = list(self.forms())
        if len(every) == 1:
            return every[0]
        everything = {p.name: self._end(p) for p in self.levels}
        responses = [self.response(form, everything) for form in every]
        return every[int(np.argmax([-np.inf if found is None else found.drop for found in responses]))]

    def belief(self, form: _Form, values: Mapping[str, float]) -> Belief:
        """The belief with the effect, its levels likely to be about where they are."""
        extended = self._before.with_effect(self.spec.name, dict(form.values) | dict(values), form.settings)
        for p in self.levels:
            own = extended[f"{self.spec.name}.{p.name}"]
            if own.log and p.name in values:
                about = float(np.log(own.value))
                extended = extended.with_parameter(own.key, prior_mean=about, prior_std=LEVEL_PRIOR)
        for p in self.spec.of_role("anchor"):
            key = f"{self.spec.name}.{p.name}"
            extended = extended.with_parameter(key, free=True, scale=extent(self.predictor.body))
        return extended

    def response(self, form: _Form, values: Mapping[str, float]) -> _Response | None:
        """What the effect does at levels, its strengths at their null; None where it cannot be simulated."""
        extended = self.belief(form, values)
        keys = {f"{self.spec.name}.{name}" for name in strengths(self.spec)}
        parameters = tuple(replace(p, free=p.key in keys) for p in extended.parameters)
        own = replace(extended, parameters=parameters)
        try:
            found = self.problem.evaluate(own, jacobian=bool(keys))
        except SimulationError:
            return None
        count = len(self._residual)
        columns = -found.jacobian[:count] if keys else np.zeros((count, 0))
        ends = np.array([[p.at(s * np.inf).coordinate for p in own.free] for s in (-1.0, 1.0)])
        return _Response(
            *map(self._left, (self._residual, self._residual - found.residual[:count], columns)),
            ends.reshape(2, -1) - own.coordinates,
            own,
        )

    def shares(self, form: _Form) -> list[dict[str, float]]:
        """Values of the levels that are tried, all combinations of them; none where none is reached."""
        choices = []
        for p in self.levels:
            stress = p.unit == "Pa" and not strengths(self.spec)
            borne, top = self._stresses() if stress else (None, self._reached(form, p))
            if top is None:
                return []
            values = [share * top if top < p.null else top / share for share in SHARES]
            values = [v for v in values if p.lower <= v <= p.upper and (borne is None or v > borne)]
            choices.append([{p.name: v} for v in values])
        return [{k: v for one in chosen for k, v in one.items()} for chosen in product(*choices)]

    def sizes(self, form: _Form) -> list[tuple[str, Belief]]:
        """Trials of what has no level: each strength at a few sizes, the others at their usual one."""
        own = [p for p in self.spec.of_role("strength") if p.fitted]
        usual = {p.name: p.scale for p in own}
        trials = []
        for p in own:
            for value in (float(np.clip(k * p.scale, p.lower, p.upper)) for k in ABOUT):
                label = _label(form, [p], {p.name: value})
                trials.append((label, self.belief(form, usual | {p.name: value})))
        return trials

    def _left(self, values: np.ndarray) -> np.ndarray:
        """What the fitted numbers do not absorb."""
        return values - self._basis @ (self._basis.T @ values)

    def _end(self, p: ParameterSpec) -> float:
        """The end of a level's span at which all of the effect acts that can."""
        low, high = _span(p)
        return low if p.null > high else high

    def _stresses(self) -> tuple[float, float]:
        """Von Mises stress that is borne at the start, and the largest one [Pa]."""
        last = self.problem.ranges[self.name][1]
        stress = self.predictor.von_mises(self._before, last, self.problem.feedback(self.name))
        return float(np.quantile(stress[0], LARGEST)), float(np.quantile(stress, LARGEST))

    def _reached(self, form: _Form, p: ParameterSpec) -> float | None:
        """Of a level's span the value nearest to its absence at which the effect still does something, by
        bisection of its logarithm, other levels where they act most; None where it does nothing anywhere."""
        others = {q.name: self._end(q) for q in self.levels if q is not p}

        def action(value: float) -> float:
            found = self.response(form, others | {p.name: value})
            return np.inf if found is None else found.action  # it acts, and how

        acts, (low, high) = self._end(p), _span(p)
        rests = high if acts == low else low
        whole = action(acts)
        if whole < NOTHING:
            return None
        least = ACTS**2 * whole if np.isfinite(whole) else NOTHING
        if action(rests) > least:
            return rests
        while abs(np.log(acts / rests)) > np.log(KNOWN_TO):
            middle = float(np.sqrt(acts * rests))
            acts, rests = (middle, rests) if action(middle) > least else (acts, middle)
        return acts


def _label(form: _Form, levels: Sequence[ParameterSpec], values: Mapping[str, float]) -> str:
    said = [f"{p.name.replace('_', ' ')} {values[p.name]:.4g} {p.unit}".removesuffix(" -") for p in levels]
    return ", ".join([*([form.said] if form.said else []), *said])
