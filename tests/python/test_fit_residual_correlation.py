"""Noise that markers share or that lasts counts for what it is in the covariance of fitted numbers."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mphygs.compare.noise import Observation
from mphygs.compare.whitening import NoiseModel
from mphygs.fit.residual_correlation import residual_correlation, widened_by_correlation

FRAMES, MARKERS = 60, 20


def noise(kind: str, rng: np.random.Generator) -> np.ndarray:
    """(T, M, 3) of variance 1: white, half of it common to all markers, or half of it lasting."""
    white = rng.normal(size=(FRAMES, MARKERS, 3))
    if kind == "white":
        return white
    if kind == "common":
        return np.sqrt(0.5) * (white + rng.normal(size=(FRAMES, 1, 3)))
    course = rng.normal(size=white.shape)
    for t in range(1, FRAMES):
        course[t] = 0.9 * course[t - 1] + np.sqrt(1.0 - 0.9**2) * course[t]
    return np.sqrt(0.5) * (white + course)


def test_white_noise_shows_nothing_and_the_others_what_they_are() -> None:
    observed = np.ones((FRAMES, MARKERS), bool)
    for seed in range(20):
        assert not residual_correlation(noise("white", np.random.default_rng(seed)), observed).found
    common = residual_correlation(noise("common", np.random.default_rng(1)), observed)
    assert common.common[0] == pytest.approx(0.5, abs=0.15) and not common.single
    own = residual_correlation(noise("lasting", np.random.default_rng(1)), observed)
    assert own.single[0] == pytest.approx(0.45, abs=0.1) and len(own.single) > 5 and not own.common


@pytest.mark.parametrize("kind", ["white", "common", "lasting"])
def test_estimates_scatter_as_their_covariance_says(kind: str) -> None:
    """A linear model with one number, fitted to many series: standardised estimates have variance one."""
    time = np.linspace(0.0, 1.0, FRAMES)[:, None, None]
    slopes = np.broadcast_to(np.sin(5.0 * time) * [1.0, 0.5, 0.2], (FRAMES, MARKERS, 3))
    column = slopes.reshape(-1, 1)
    inverse = np.linalg.inv(column.T @ column)
    still = Observation(np.zeros((FRAMES, MARKERS, 3)), NoiseModel.white(1.0, "stated"), np.ones(MARKERS))
    problem = SimpleNamespace(whitener=lambda _: still.whitener(0, FRAMES))
    squares, alone = [], []
    for seed in range(100):
        measured = noise(kind, np.random.default_rng(100 + seed)).reshape(-1)
        estimate = float((inverse @ column.T @ measured)[0])
        left = measured - column[:, 0] * estimate
        evaluation = SimpleNamespace(rows={"a": slice(0, len(left))}, residual=left, jacobian=column)
        variance = (inverse + widened_by_correlation(problem, evaluation, inverse))[0, 0]
        squares.append(estimate**2 / variance)
        alone.append(estimate**2 / inverse[0, 0])
    assert 0.7 < np.mean(squares) < 1.5
    assert bool(np.mean(alone) > 3.0) is (kind != "white")
