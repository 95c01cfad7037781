"""What does not deform is told as a bound with its sign."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from command_example import answer
from extend_example import SIGMA, recorded
from mphygs.capture.record import Known
from mphygs.capture.save import save_capture
from mphygs.commands import fit
from mphygs.fit.determined import SAYS_NOTHING
from mphygs.fit.limits import Limits, narrowed_to_seen, with_bounds
from mphygs.fit.one_sided import derivatives_hold, limits_of
from mphygs.fit.run import load_run
from mphygs.fit.tables import parameter_lines, parameters_of
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

KEY = "part0.youngs_modulus"
FRAMES = 24


class Sagging:
    """A problem of one row that sags by `load` / E sigma, where `seen` was seen to; softer than `least` it is
    torn."""

    def __init__(self, load: float, seen: float | np.ndarray = 0.0, least: float = 0.0) -> None:
        self.load, self.seen, self.least = load, seen, least

    def stable_substep(self, belief: Belief) -> float:
        return belief[KEY].value ** -0.5

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> SimpleNamespace:
        value = belief[KEY].value
        if value < self.least:
            raise SimulationError("unstable")
        sag = self.load / value
        return SimpleNamespace(
            residual=np.array([self.seen - sag]), jacobian=np.array([[sag]]), data_rows=1, rows={}, misfit=1.0
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
            found = super().evaluate(belief).__dict__
            slid = 1e3 * np.log(belief["part0.density"].value / 1e3)
            sag = float(found["jacobian"][0, 0])
            return SimpleNamespace(
                **found | {"residual": found["residual"] + slid, "jacobian": np.array([[sag, 1e3]])}
            )

    belief = bar_belief(bar_capture(), youngs_modulus=1e6, free=(KEY, "part0.density"))
    problem = Sliding(9e6, seen=9.0)
    assert limits_of(problem, belief, problem.evaluate(belief))[KEY].stiff is None


class Tied(Sagging):
    """The same on a tether, by `load` / k sigma; its derivative is `off` times what the motion has."""

    def __init__(self, load: float, seen: float, off: float = 1.0) -> None:
        super().__init__(load, seen)
        self.off = off

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> SimpleNamespace:
        k = belief["tether.k"]
        give = self.load / (k.value + 1e-9)
        slope = self.off * give * k.scale / (k.value + 1e-9)
        left = np.array([self.seen - give])
        return SimpleNamespace(
            residual=left, jacobian=np.array([[slope]]), data_rows=1, rows={}, misfit=1.0
        )


def with_tether(k: float) -> Belief:
    belief = bar_belief(bar_capture(), youngs_modulus=1e6, free=()).with_effect("tether", {"k": k})
    for key in ("tether.anchor_x", "tether.anchor_y", "tether.anchor_z"):
        belief = belief.with_parameter(key, free=False)
    return belief


def tied(problem: Tied, k: float) -> tuple[Limits, dict[str, object]]:
    belief = with_tether(k)
    evaluation = problem.evaluate(belief)
    limits = limits_of(problem, belief, evaluation)
    information = evaluation.jacobian.T @ evaluation.jacobian
    known = narrowed_to_seen(belief.free, information, np.linalg.inv(information), limits)
    return limits["tether.k"], parameter_lines(belief, *known, 1.0, limits)["tether.k"]


def test_how_much_there_is_of_an_effect_is_told_as_a_bound_where_more_of_it_shows_no_more() -> None:
    limits, entry = tied(Tied(4e3, seen=0.0), 1e3)
    assert limits.stiff is None and not entry["determined"]
    # 4 sigma at k, so that what gives three more than nothing is excluded
    assert entry["bound"] == {"lower": pytest.approx(4e3 / 5.0, rel=0.2)}
    assert "less of it does not fit" in entry["note"]
    limits, entry = tied(Tied(3e4, seen=30.0), 1e3)
    assert limits.seen and entry["determined"] and "bound" not in entry
    # One that is next to nothing is told by its error as well as any, though a hundred times as much fits.
    weak = Limits(None, 3.0, weak=True)
    assert weak.seen and not replace(weak, weak=False).seen


def test_a_derivative_that_the_motion_does_not_have_gives_no_standard_error() -> None:
    belief = with_tether(1e3)
    true, false = Tied(3e4, 30.0), Tied(3e4, 30.0, off=1e6)
    assert derivatives_hold(true, belief, true.evaluate(belief))
    assert not derivatives_hold(false, belief, false.evaluate(belief))
    limits, entry = tied(false, 1e3)
    assert limits.leaps and not entry["determined"] and entry["std"] > 0.01
    assert entry["bound"]["lower"] < 1e3 < entry["bound"]["upper"] and "by leaps" in entry["note"]


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
            return SimpleNamespace(residual=left, jacobian=slope[:, None], data_rows=240, rows={}, misfit=1.0)

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
        assert parameters_of(state)[KEY] == entry
        assert state.information[0, 0] == 0.0 and state.covariance[0, 0] > 1.0
