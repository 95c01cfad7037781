"""The lower of two minima is found, and errors that are stated hold, on captures of another grid."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from command_example import answer
from mphygs.commands import fit, synth
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.other_minima import beyond_crests, lower_along
from mphygs.fit.problem import Evaluation
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

OF = {"youngs_modulus": "E", "density": "rho"}


KEY = "part0.youngs_modulus"


class Shoulder:
    """A minimum at 100 kPa whose wall on the soft side ends on a shoulder, from which the cost falls by half
    of `deep` in the end; softer than `least` nothing can be simulated."""

    def __init__(self, deep: float, least: float = 0.0) -> None:
        self.deep, self.least = deep, least

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
        value = belief[KEY].value
        if value < self.least:
            raise SimulationError("unstable")
        x = np.log(value / 1e5)
        wall = 130.0 * (x if x > 0.0 else 0.02 * np.tanh(x / 0.02))
        rest = np.sqrt(100.0 - self.deep * (x < 0.0) * x**2 / (x**2 + 0.01))
        slopes = np.array([[130.0], [0.0]])  # at the minimum
        return Evaluation(np.array([wall, rest]), slopes, 2, 0, {}, {}, 1)


def lower(problem: Shoulder) -> list[float]:
    belief = bar_belief(bar_capture(), youngs_modulus=1e5, free=(KEY,))
    solution = Solution(belief, problem.evaluate(belief), (0.0,), True, "converged")
    return [there[KEY].value / 1e5 for there in lower_along(problem, solution)]


def test_a_lower_cost_on_a_shoulder_of_the_valley_is_found() -> None:
    first, second = lower(Shoulder(60.0))
    assert first == pytest.approx(np.exp(-16.0 / 130.0)) and second == pytest.approx(np.exp(-8.0 / 130.0))
    assert lower(Shoulder(0.0)) == []
    assert lower(Shoulder(60.0, least=0.92e5)) == [pytest.approx(np.exp(-8.0 / 130.0))]


class Ripples:
    """A wide valley about 100 kPa with ripples, a factor of exp(0.15) from one to the next; softer than
    `least` nothing can be simulated."""

    def __init__(self, high: float, least: float = 0.0) -> None:
        self.high, self.least, self.asked = high, least, 0

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
        self.asked += 1
        value = belief[KEY].value
        if value < self.least:
            raise SimulationError("unstable")
        x = np.log(value / 1e5)
        phase = np.pi * x / 0.15
        slopes = np.array([[self.high * np.pi / 0.15 * np.cos(phase)], [30.0], [0.0]])
        return Evaluation(np.array([self.high * np.sin(phase), 30.0 * x, 60.0]), slopes, 3, 0, {}, {}, 1)


def test_minima_beyond_the_crests_of_a_valley_are_found() -> None:
    def beyond(problem: Ripples, at: float) -> list[float]:
        belief = bar_belief(bar_capture(), youngs_modulus=1e5 * np.exp(at), free=(KEY,))
        solution = Solution(belief, problem.evaluate(belief), (0.0,), True, "converged")
        return [np.log(there[KEY].value / 1e5) for there in beyond_crests(problem, solution)]

    step = 0.02
    found = beyond(Ripples(20.0), 0.45)
    assert found[:2] == pytest.approx([0.0, 0.15], abs=step)
    assert len(found) >= 6  # those of a higher cost behind
    assert beyond(Ripples(20.0), -0.45)[0] == pytest.approx(0.0, abs=step)
    assert beyond(Ripples(20.0, least=1e5 * np.exp(0.1)), 0.45)[0] == pytest.approx(0.15, abs=step)
    smooth = Ripples(0.0)
    assert beyond(smooth, 0.0) == [] and smooth.asked < 5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "seed", "simulator"),
    [
        ("two-part-bar", 13, "total-lagrangian"),  # a second minimum, the lower on the coarse grid
        ("bar", 21, "finite-element"),
    ],
)
def test_truth_is_within_two_standard_errors(tmp_path: Path, kind: str, seed: int, simulator: str) -> None:
    answer(
        synth.main, kind, "--seed", str(seed), "--simulator", simulator, "--frames", "30",
        "--markers", "30", "--out", tmp_path / "made",
    )  # fmt: skip
    truth = json.loads((tmp_path / "made" / "answer.json").read_text())["parts"]
    found = answer(fit.main, tmp_path / "made", "--out", tmp_path / "run")["parameters"]
    checked = 0
    for key, entry in found.items():
        part, _, name = key.rpartition(".")
        if name in OF:
            error = entry["value"] - truth[part][OF[name]]
            assert abs(error) < 2.0 * entry["std"], key
            assert abs(error) < 0.12 * entry["value"], key
            checked += 1
    assert checked == (3 if kind == "two-part-bar" else 1)
