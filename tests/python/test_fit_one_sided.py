"""What does not deform is told as a bound with its sign."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.fit.one_sided import one_sided, with_bounds
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

KEY = "part0.youngs_modulus"


class Sagging:
    """A problem that sags by `load` / E sigma, where nothing was seen to; softer than `least` it is torn."""

    def __init__(self, load: float, least: float = 0.0) -> None:
        self.load, self.least = load, least

    def evaluate(self, belief: Belief, *, jacobian: bool) -> SimpleNamespace:
        value = belief[KEY].value
        if value < self.least:
            raise SimulationError("unstable")
        return SimpleNamespace(chi_square=(self.load / value) ** 2)


def found(problem: Sagging, determined: bool = False) -> dict[str, dict[str, float]]:
    belief = bar_belief(bar_capture(), youngs_modulus=1e6, free=(KEY,))
    return one_sided(problem, belief, {KEY: {"determined": determined}})


def test_a_body_that_does_not_sag_is_at_least_so_stiff() -> None:
    bound = found(Sagging(3e4))[KEY]
    assert list(bound) == ["lower"] and bound["lower"] == pytest.approx(1e4, rel=0.2)
    told = with_bounds({KEY: {"unit": "Pa", "note": "the data say nothing about it"}}, {KEY: bound})[KEY]
    assert told["bound"] == bound and "say nothing" in told["note"] and "at least" in told["note"]
    # Chi^2 rises to where it cannot be simulated: that is excluded as well.
    assert found(Sagging(1.0, least=2e5))[KEY]["lower"] == pytest.approx(2e5, rel=0.2)


def test_nothing_is_said_of_what_is_determined_or_has_no_say() -> None:
    assert found(Sagging(3e4), determined=True) == {}
    assert found(Sagging(0.0)) == {}
