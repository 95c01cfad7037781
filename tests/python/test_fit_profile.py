"""Intervals from the likelihood, against closed forms and on a fitted motion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.fit import determined
from mphygs.fit.problem import Evaluation
from mphygs.fit.profile import Profile, intervals
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

SIGMA = 0.02


@dataclass
class Formula:
    """Residuals of two logarithms a and b: (a + b - 1, a - b) / SIGMA with `power` 1, else
    ((a + 2)^power - 1, b) / SIGMA. limit: |a| beyond which nothing can be simulated."""

    power: float = 1.0
    limit: float = math.inf

    def stable_substep(self, belief: Belief) -> float:
        return 1.0

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
        a, b = (math.log(belief[k].value / 1e4) for k in KEYS)
        if abs(a) > self.limit:
            raise SimulationError("too far")
        if self.power == 1.0:
            residual = np.array([a + b - 1.0, a - b]) / SIGMA
            slope = np.array([[1.0, 1.0], [1.0, -1.0]]) / SIGMA
        else:
            residual = np.array([(a + 2.0) ** self.power - 1.0, b]) / SIGMA
            slope = np.diag([self.power * (a + 2.0) ** (self.power - 1.0), 1.0]) / SIGMA
        columns = [k for k, key in enumerate(KEYS) if belief[key].free]
        prior = np.array([p.prior_residual for p in belief.free]).reshape(-1, 2)
        rows = np.concatenate([slope[:, columns], np.diag(prior[:, 1])])
        return Evaluation(np.r_[residual, prior[:, 0]], rows, 2, len(prior), {}, {}, 1)


KEYS = ("part0.youngs_modulus", "part1.youngs_modulus")


def belief_at(a: float, b: float) -> Belief:
    capture = bar_capture(lengths=(0.024, 0.024), frames=4)
    return bar_belief(
        capture, youngs_modulus=(1e4 * math.exp(a), 1e4 * math.exp(b)), density=(1e3, 1e3), free=KEYS
    )


def test_the_interval_of_a_linear_problem_is_its_standard_errors() -> None:
    found = intervals(Formula(), belief_at(0.3, 0.4))
    # C = (J^T J)^-1 = SIGMA^2 / 2 of both: a = b = 1/2 at the minimum.
    for key in KEYS:
        low, high = (math.log(v / 1e4) for v in (found[key].lower, found[key].upper))
        assert low == pytest.approx(0.5 - 2.0 * SIGMA / math.sqrt(2.0), abs=0.03 * SIGMA)
        assert high == pytest.approx(0.5 + 2.0 * SIGMA / math.sqrt(2.0), abs=0.03 * SIGMA)


def test_a_prior_narrows_its_own_parameters_interval() -> None:
    belief = belief_at(0.5, 0.5)
    prior = {"prior_mean": math.log(1e4) + 0.5, "prior_std": SIGMA / math.sqrt(2.0)}  # as good as the data
    found = intervals(Formula(), belief.with_parameter(KEYS[0], **prior))
    high = [math.log(found[key].upper / 1e4) for key in KEYS]
    assert high[0] == pytest.approx(0.5 + SIGMA, abs=0.03 * SIGMA)
    assert high[1] == pytest.approx(0.5 + 2.0 * SIGMA / math.sqrt(2.0), abs=0.03 * SIGMA)


def test_components_of_a_direction_have_no_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(determined, "_directions", lambda: [KEYS])
    assert intervals(Formula(), belief_at(0.5, 0.5)) == {}
    one = belief_at(0.5, 0.5).with_parameter(KEYS[1], free=False)
    assert list(intervals(Formula(), one)) == [KEYS[0]]


def test_the_interval_of_a_curved_problem_is_lopsided_as_it_should_be() -> None:
    profile = Profile.of(Formula(power=0.25), belief_at(-0.9, 0.2))
    found = profile.interval(KEYS[0])
    low, high = (math.log(v / 1e4) for v in (found.lower, found.upper))
    assert low == pytest.approx((1.0 - 2.0 * SIGMA) ** 4 - 2.0, abs=0.01)
    assert high == pytest.approx((1.0 + 2.0 * SIGMA) ** 4 - 2.0, abs=0.01)
    assert high + 1.0 > 1.1 * (-1.0 - low)
    value = 1e4 * math.exp((1.0 + 3.0 * SIGMA) ** 4 - 2.0)
    assert profile.root(KEYS[0], value) == pytest.approx(3.0, rel=0.01)
    assert profile.root(KEYS[0], profile.solution.belief[KEYS[0]].value) == 0.0


def test_an_interval_ends_at_the_bound_that_the_misfit_allows() -> None:
    belief = belief_at(0.5, 0.5)
    reached = belief.with_parameter(KEYS[0], lower=0.99 * belief[KEYS[0]].value)
    found = intervals(Formula(), reached)[KEYS[0]]
    assert found.lower == pytest.approx(0.99 * belief[KEYS[0]].value)
    assert math.log(found.upper / 1e4) == pytest.approx(0.5 + 2.0 * SIGMA / math.sqrt(2.0), abs=0.03 * SIGMA)


def test_where_nothing_can_be_simulated_the_interval_ends_before() -> None:
    found = intervals(Formula(limit=0.515), belief_at(0.5, 0.5))[KEYS[0]]
    assert 0.51 < math.log(found.upper / 1e4) <= 0.515
    with pytest.raises(KeyError):
        Profile.of(Formula(), belief_at(0.5, 0.5)).root("viscosity.eta", 1.0)
