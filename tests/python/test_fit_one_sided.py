"""What does not deform is told as a bound with its sign."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from command_example import answer
from extend_example import SIGMA, recorded
from mphygs.capture.record import Known
from mphygs.capture.save import save_capture
from mphygs.fit import __main__ as fit
from mphygs.fit.determined import SAYS_NOTHING
from mphygs.fit.one_sided import Limits, limits_of, with_bounds
from mphygs.fit.run import load_run
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

KEY = "part0.youngs_modulus"
FRAMES = 24


class Sagging:
    """A problem of one row that sags by `load` / E sigma, where `seen` was seen to; softer than `least` it is
    torn."""

    def __init__(self, load: float, seen: float | np.ndarray = 0.0, least: float = 0.0) -> None:
        self.load, self.seen, self.least = load, seen, least

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> SimpleNamespace:
        value = belief[KEY].value
        if value < self.least:
            raise SimulationError("unstable")
        sag = self.load / value
        return SimpleNamespace(
            residual=np.array([self.seen - sag]), jacobian=np.array([[sag]]), data_rows=1, rows={}
        )


def found(problem: Sagging, value: float = 1e6) -> Limits:
    belief = bar_belief(bar_capture(), youngs_modulus=value, free=(KEY,))
    return limits_of(problem, belief, problem.evaluate(belief))[KEY]


def test_a_body_that_does_not_sag_is_at_least_so_stiff() -> None:
    limits = found(Sagging(3e4))
    assert limits.stiff is None
    assert limits.bound(1e6)["lower"] == pytest.approx(1e4, rel=0.2)
    # Chi^2 rises to where it cannot be simulated: that is excluded as well.
    assert found(Sagging(1.0, least=2e5)).bound(1e6)["lower"] == pytest.approx(2e5, rel=0.2)


def test_a_sag_of_six_sigma_is_seen_on_both_sides_and_one_of_four_is_not() -> None:
    assert found(Sagging(9e6, seen=9.0)).seen
    # As good as rigid is four standard deviations off, which the best of many stiffnesses may be by chance.
    accident = found(Sagging(4e6, seen=4.0))
    assert accident.stiff is None and accident.soft is not None


def test_a_free_number_that_follows_takes_the_say_from_a_stiffness() -> None:
    class Sliding(Sagging):
        def evaluate(self, belief: Belief, *, jacobian: bool = True) -> SimpleNamespace:
            return SimpleNamespace(
                **super().evaluate(belief).__dict__ | {"jacobian": np.array([[9.0, 1e3]])}
            )

    belief = bar_belief(bar_capture(), youngs_modulus=1e6, free=(KEY, "part0.density"))
    problem = Sliding(9e6, seen=9.0)
    assert limits_of(problem, belief, problem.evaluate(belief))[KEY].stiff is None


def test_nothing_is_said_of_what_is_determined_or_has_no_say() -> None:
    nothing = found(Sagging(0.0))
    assert nothing == Limits(None, None) and nothing.bound(1e6) == {}
    told = {KEY: {"value": 1e6, "unit": "Pa", "determined": True}}
    assert with_bounds(told, {KEY: Limits(0.01, None)}) == told


def test_a_bound_says_so_in_words() -> None:
    for note in (SAYS_NOTHING, "the data determine a / b only"):
        told = {KEY: {"value": 1e6, "unit": "Pa", "determined": False, "note": note}}
        entry = with_bounds(told, {KEY: Limits(0.01, None)})[KEY]
        assert entry["bound"] == {"lower": 1e4} and "at least 1e+04 Pa" in entry["note"]
        assert (note in entry["note"]) is (note != SAYS_NOTHING)
        assert not entry["note"].startswith(";")


def test_vibrations_that_fit_in_several_phases_tell_a_stiffness_roughly() -> None:
    t, swings = np.arange(240.0), np.arange(240) < 40

    class Ringing(Sagging):
        """Swings of `load` sigma over 40 of 240 frames, whose frequency goes with the root of E."""

        def evaluate(self, belief: Belief, *, jacobian: bool = True) -> SimpleNamespace:
            root = np.sqrt(belief[KEY].value / 1e6)
            tall = self.load / root**2
            slope = swings * tall * (np.cos(7.0 * t * root) + 3.5 * t * root * np.sin(7.0 * t * root))
            left = swings * (self.seen - tall * np.cos(7.0 * t * root))
            return SimpleNamespace(residual=left, jacobian=slope[:, None], data_rows=240, rows={})

    once, twice = 1.4 * np.cos(7.0 * t), 1.4 * (np.cos(7.0 * t) + np.cos(7.0 * 1.035 * t))
    known, other = (found(Ringing(1.4, seen=seen)) for seen in (once, twice))
    assert known.seen and known.bound(1e6) == {}
    assert other.phases and not other.seen
    told = {KEY: {"value": 1e6, "unit": "Pa", "determined": False, "note": SAYS_NOTHING}}
    entry = with_bounds(told, {KEY: other})[KEY]
    assert entry["bound"]["lower"] < 1e6 < entry["bound"]["upper"]
    assert entry["note"].startswith("between ")


def test_a_bar_that_hardly_yields_is_told_by_a_bound_and_a_soft_one_by_a_number(tmp_path: Path) -> None:
    shake = 0.006 * np.sin(np.linspace(0.0, 9.0, FRAMES))[:, None] * [0.2, 1.0, 0.4]
    known = Known(density={"part0": 1000.0}, poissons_ratio=0.3)
    for truth, share in ((5e4, 1.0), (2e7, 0.002)):
        capture = bar_capture(
            frames=FRAMES, fps=60.0, motion=share * shake, fit=(0, FRAMES), sigma=SIGMA, known=known
        )
        folder = tmp_path / f"{truth:.0f}"
        save_capture(recorded(capture, bar_belief(capture, youngs_modulus=truth)), folder)
        run = tmp_path / f"run-{truth:.0f}"
        options = (folder, "--out", run, "--spacing", "0.01", "--workers", 1)
        (entry,) = answer(fit.main, *options)["parameters"].values()
        state = load_run(run)
        if share == 1.0:
            assert entry["determined"] and abs(entry["value"] - truth) < 3.0 * entry["std"]
            assert state.information[0, 0] > 0.0 and "bound" not in entry
            continue
        assert not entry["determined"] and entry["std"] > entry["value"]
        assert 1e4 < entry["bound"]["lower"] < truth < entry["bound"].get("upper", np.inf)
        # The run knows it as well: no later command takes the minimum for a number.
        assert state.information[0, 0] == 0.0 and state.covariance[0, 0] > 1.0
