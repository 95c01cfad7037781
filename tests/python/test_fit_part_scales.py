"""Parts far apart in stiffness, each found at its own scale."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import recorded
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.part_scales import on_by_part, other_scales
from mphygs.fit.schedule import fit_belief
from mphygs.fit.stiffness_scale import CONTRAST, about_its_scale
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Settings

KEYS = ("part0.youngs_modulus", "part1.youngs_modulus")


def at(*moduli: float) -> Belief:
    capture = bar_capture(lengths=(0.02, 0.02))
    return about_its_scale(bar_belief(capture, youngs_modulus=moduli, free=KEYS))


class Decades:
    """A problem whose cost depends on the decades of two moduli; nothing softer than 1 kPa is simulated."""

    def __init__(self, cost: object, misfit: float = 3.0) -> None:
        self.cost, self.misfit, self.asked = cost, misfit, []

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> SimpleNamespace:
        decades = np.log10([belief[key].value for key in KEYS])
        self.asked.append(tuple(np.round(decades, 2)))
        if decades.min() < 3.0:
            raise SimulationError("jelly")
        return SimpleNamespace(cost=self.cost(*decades), misfit=self.misfit)


@pytest.mark.parametrize(("stiff", "soft"), [(1e7, 5e4), (5e4, 1e7)])
def test_a_fit_finds_parts_two_hundred_times_apart(stiff: float, soft: float) -> None:
    frames = 24
    times = np.arange(frames) / 100.0
    shake = 0.004 * np.sin(2 * np.pi * 9.0 * times) * np.minimum(times / 0.05, 1.0)
    at = [[x, y, z] for x in (0.01, 0.02, 0.03, 0.04, 0.05, 0.06) for y, z in ((0, 0.004), (0.008, 0.008))]
    capture = bar_capture(
        lengths=(0.03, 0.06), side=0.008, frames=frames, fps=100.0, motion=shake[:, None] * [0.0, 1.0, 0.4],
        fit=(0, frames), gravity=np.zeros(3), markers_at=np.array(at),
    )  # fmt: skip
    truth = bar_belief(capture, youngs_modulus=(stiff, soft), free=KEYS)
    capture = recorded(capture, truth, 0.008)
    start = truth
    for key in KEYS:
        start = start.with_parameter(key, value=1e5, prior_mean=float(np.log(1e5)), prior_std=2.5)
    experiment = Experiment.of(capture, Settings(0.008, workers=1))
    experiment.problem(0.008)
    found, _ = fit_belief(capture, start, experiment.fitted, experiment.observations, experiment.settings)
    assert found.evaluation.misfit < 1.05
    soft_key = KEYS[int(soft < stiff)]
    assert found.belief[soft_key].value == pytest.approx(min(stiff, soft), rel=0.05)
    # A stiff tip of a soft bar hardly bends.
    rel = 0.25 if stiff > soft else 0.6
    assert found.belief[KEYS[int(soft > stiff)]].value == pytest.approx(max(stiff, soft), rel=rel)


def test_a_part_is_moved_by_decades_as_long_as_that_fits_better() -> None:
    problem = Decades(lambda a, b: 10.0 + 40.0 * abs(a - 8.0) + 30.0 * abs(b - 5.2))
    begin = at(1e8, 1e8)
    found = other_scales(problem, begin, problem.evaluate(begin), 1e-3)
    assert [found[key].value for key in KEYS] == pytest.approx([1e8, 1e5])
    # Its bounds are about its own scale then, those of the other as they were.
    moved = found[KEYS[1]]
    assert (moved.lower, moved.upper) == pytest.approx((1e5 / CONTRAST, 1e5 * CONTRAST))
    assert found[KEYS[0]] == begin[KEYS[0]]
    # Where nothing moves it has cost two runs a part.
    problem.asked.clear()
    assert other_scales(problem, found, problem.evaluate(found), 1e-3) is None
    assert len(problem.asked) == 1 + 4


@pytest.mark.parametrize("valley", [7.0, 6.0, 6.25, 6.5])
def test_a_part_is_found_beyond_decades_at_which_it_is_rigid(valley: float) -> None:
    """Softer than that it falls by its weight; the valley is a third of a decade wide."""

    def cost(a: float, b: float) -> float:
        if abs(b - valley) < 0.17:
            return 10.0
        return float(100.0 + 3.0 * np.sin(5.0 * b) + 1e3 * max(valley - 0.3 - b, 0.0))

    problem, begin = Decades(cost), at(1e8, 1e8)
    found = other_scales(problem, begin, problem.evaluate(begin), 1e-3)
    assert np.log10(found[KEYS[1]].value) == pytest.approx(valley, abs=0.17)
    assert found[KEYS[0]] == begin[KEYS[0]]


def test_what_cannot_be_simulated_or_hardly_helps_is_left() -> None:
    # Softer is better still where nothing can be simulated any more.
    problem = Decades(lambda a, b: 100.0 + a - 8.0 + 30.0 * b)
    begin = at(1e8, 1e5)
    assert other_scales(problem, begin, problem.evaluate(begin), 1e-2)[KEYS[1]].value == pytest.approx(1e3)
    # The other one falls by a hundredth a decade: of a misfit of six sigma that is no reason.
    hardly = Decades(lambda a, b: 100.0 + a + 30.0 * abs(b - 5.0), misfit=6.0)
    assert other_scales(hardly, begin, hardly.evaluate(begin), 1e-2) is None
    single = replace(begin, parameters=tuple(replace(p, free=p.key == KEYS[1]) for p in begin.parameters))
    assert other_scales(problem, single, problem.evaluate(single), 1e-2) is None


@pytest.mark.parametrize("beyond", [7.0, 6.3])
def test_a_part_at_a_bound_of_its_scale_is_looked_for_just_beyond(beyond: float) -> None:
    begin = at(1e5, 1e5)
    begin = begin.with_parameter(KEYS[0], value=begin[KEYS[0]].upper)
    edge = np.log10(begin[KEYS[0]].value)
    problem = Decades(lambda a, b: 100.0 + 40.0 * abs(a - edge - 0.3) + 30.0 * abs(b - 5.0))
    found = other_scales(problem, begin, problem.evaluate(begin), 1e-3)[KEYS[0]]
    assert 0.2 < np.log10(found.value) - edge < 0.55 and found.upper > begin[KEYS[0]].upper


@pytest.mark.parametrize(("misfit", "fits"), [(3.0, 2), (1.5, 1)])
def test_only_a_fit_that_leaves_more_than_noise_goes_on(misfit: float, fits: int) -> None:
    problem = Decades(lambda a, b: 100.0 + 30.0 * abs(b - 5.0), misfit)
    done: list[Belief] = []

    def again(belief: Belief) -> Solution:
        done.append(belief)
        evaluation = problem.evaluate(belief)
        return Solution(belief, evaluation, (evaluation.cost,), True, "converged")

    found = on_by_part(problem, again(at(1e8, 1e8)), again, accuracy=1e-3)
    assert len(done) == fits and found.history == (190.0, 100.0)[:fits]
    assert found.belief[KEYS[1]].value == pytest.approx((1e8, 1e5)[fits - 1])
