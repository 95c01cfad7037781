"""Known truth found again: exactly from clean markers, within its standard errors from noisy ones."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.compare.noise import Observation
from mphygs.compare.whitening import NoiseModel
from mphygs.fit.levenberg_marquardt import Solution, covariance, minimise
from mphygs.fit.problem import Problem
from mphygs.fit.profile import Profile, intervals
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor, Settings

SIGMA = 1e-4  # [m]
SEEDS = 500
SUBSTEP = 7e-4  # [s]
# The first part's density is known: motion by weight and by a hold tells stiffness over density alone.
TRUTH = {
    "part0.youngs_modulus": 5e4,
    "part1.youngs_modulus": 2.5e4,
    "part1.density": 800.0,
    "viscosity.eta": 6.0,
    "mass_damping.alpha": 1.5,
}
# So far off does the search begin: factors of the truth, and effects that are nearly absent.
START = (1.8, 0.5, 1.4, 0.05, 0.05)


@cache
def scene() -> tuple[Predictor, Belief, np.ndarray]:
    """The simulator, the true belief, and clean markers (T, M, 3) [m]."""
    shake = 0.006 * np.sin(np.linspace(0.0, 6.0, 20))[:, None] * [0.3, 1.0, 0.0]
    capture = bar_capture(lengths=(0.024, 0.024), frames=20, motion=shake)
    belief = bar_belief(
        capture, youngs_modulus=(5e4, 2.5e4), density=(1000.0, 800.0), free=tuple(TRUTH)[:3]
    ).with_effect("viscosity", {"eta": 6.0})
    belief = belief.with_effect("mass_damping", {"alpha": 1.5})
    assert tuple(p.key for p in belief.free) == tuple(TRUTH)
    predictor = Predictor(capture, capture.sequence("a"), Settings(0.012, workers=1))
    return predictor, belief, predictor.predict(belief, substep=SUBSTEP).position


def problem_of(position: np.ndarray) -> Problem:
    predictor, _, _ = scene()
    observation = Observation(position, NoiseModel.white(SIGMA, "stated"), np.ones(position.shape[1]))
    ranges, observations, predictors = {"a": (1, len(position))}, {"a": observation}, {"a": predictor}
    return Problem(predictor.capture, predictor.settings, ranges, observations, predictors, SUBSTEP)


def fitted(position: np.ndarray, start: Belief, tolerance: float) -> Solution:
    problem = problem_of(position)
    return minimise(problem, start, iterations=30, tolerance=tolerance, relative_tolerance=1e-6)


def test_clean_markers_give_every_parameter_within_a_hundredth() -> None:
    _, truth, position = scene()
    start = truth
    for key, factor in zip(TRUTH, START, strict=True):
        start = start.with_parameter(key, value=truth[key].value * factor)
    solution = fitted(position, start, 1e-8)
    for key, value in TRUTH.items():
        assert solution.belief[key].value == pytest.approx(value, rel=0.01), key


@pytest.mark.slow
def test_noisy_markers_give_every_parameter_within_two_standard_errors() -> None:
    _, truth, position = scene()
    away, errors_away, costs = [], [], []
    for seed in range(SEEDS):
        noise = SIGMA * np.random.default_rng(seed).standard_normal(position.shape)
        solution = fitted(position + noise, truth, 1e-3)
        errors = np.sqrt(np.diag(covariance(solution.evaluation)))
        errors_away.append((solution.belief.coordinates - truth.coordinates) / errors)
        profile = Profile(problem_of(position + noise), solution)
        away.append([profile.root(key, value) for key, value in TRUTH.items()])
        costs.append(solution.evaluation.chi_square / (solution.evaluation.data_rows - len(TRUTH)))
    away, errors_away = np.array(away), np.array(errors_away)
    # The truth is in the interval of the likelihood; that of the standard errors, which are 11 and 19 % of
    # eta and alpha and grow with them, is nearly as good.
    assert (np.abs(away) < 2.0).mean() >= 19 / 20, (np.abs(away) < 2.0).mean(0)
    assert (np.abs(errors_away) < 2.0).mean() > 0.94, (np.abs(errors_away) < 2.0).mean(0)
    # Errors that are too large would pass that: they must be as large as what they stand for.
    for scores in (away, errors_away):
        assert 0.9 < np.sqrt((scores**2).mean()) < 1.1, scores
    # A fit of a curved model is off by about half its relative error, in standard errors.
    assert (np.abs(away.mean(0)) < 0.2).all(), away.mean(0)
    assert 0.9 < np.mean(costs) < 1.1


def test_the_interval_of_the_likelihood_ends_two_deviations_away() -> None:
    _, truth, position = scene()
    noisy = position + SIGMA * np.random.default_rng(1).standard_normal(position.shape)
    problem = problem_of(noisy)
    solution = fitted(noisy, truth, 1e-3)
    profile = Profile(problem, solution)
    found = intervals(problem, solution.belief)
    assert set(found) == set(TRUTH)
    errors = np.sqrt(np.diag(covariance(solution.evaluation)))
    for parameter, error in zip(solution.belief.free, errors, strict=True):
        key, interval = parameter.key, found[parameter.key]
        inside = interval.lower < TRUTH[key] < interval.upper
        assert inside == (abs(profile.root(key, TRUTH[key])) < 2.0), key
        assert profile.root(key, interval.lower) == pytest.approx(-2.0, abs=0.06), key
        assert profile.root(key, interval.upper) == pytest.approx(2.0, abs=0.06), key
        assert 0.8 < (interval.upper - interval.lower) / (4.0 * error * parameter.slope) < 1.4, key
