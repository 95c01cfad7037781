"""A sigma that the misfit itself belies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mphygs.compare.assess import Compared
from mphygs.compare.masked_means import mean_seen
from mphygs.compare.noise import Observation
from mphygs.compare.roughness import doubted_sigma, jumps, opposed
from mphygs.compare.sequence_pictures import sequence_figure
from mphygs.compare.whitening import NoiseModel

FRAMES, MARKERS, SIGMA = 80, 60, 1e-4


def compared(
    noise: float, swing: float, *, missing: float = 0.0, period: float = 10.0
) -> dict[str, Compared]:
    """White noise, and a swing of all markers, so many frames long, that the prediction lacks [m]."""
    draw = np.random.default_rng(5)
    times = np.arange(FRAMES)[:, None, None]
    position = noise * draw.standard_normal((FRAMES, MARKERS, 3))
    position = position + swing * np.sqrt(2.0) * np.sin(2.0 * np.pi / period * times)
    position[draw.random((FRAMES, MARKERS)) < missing] = np.nan
    item = Compared(
        Observation(position, NoiseModel.white(SIGMA, "as stated"), np.ones(MARKERS)),
        np.zeros_like(position),
        np.zeros((*position.shape, 0)),
        np.zeros(MARKERS, int),
        (0, 50),
        (50, FRAMES),
    )
    return {"b": item}


@pytest.mark.parametrize("missing", [0.0, 0.15])
def test_jumps_are_the_noise_beside_a_swing(missing: float) -> None:
    item = compared(3e-4, 1e-3, missing=missing)["b"]
    assert jumps(item.observation.position) == pytest.approx(3e-4, rel=0.15)
    assert jumps(compared(0.0, 1e-3)["b"].observation.position) < 0.1 * 1e-3


def test_a_sigma_is_doubted_where_most_of_the_misfit_is_more_noise_than_it_says() -> None:
    (line,) = doubted_sigma(compared(3e-4, 1e-4, missing=0.1))
    assert line.startswith("'b': ") and "sigma (0.1 mm: as stated) may be 3 times too small" in line
    assert doubted_sigma(compared(1e-4, 0.0)) == []
    # a misfit that goes on is physics, whatever the noise
    assert doubted_sigma(compared(3e-4, 1e-3)) == [] and doubted_sigma(compared(1e-4, 1e-3)) == []
    # a fast one jumps as much as noise does, but goes on
    fast = compared(1e-4, 1e-3, period=3.3)
    assert jumps(fast["b"].observation.position) > 0.9 * 1e-3 and doubted_sigma(fast) == []


@pytest.mark.parametrize("missing", [0.0, 0.15])
def test_differences_of_noise_are_opposed(missing: float) -> None:
    noise = compared(1e-4, 0.0, missing=missing)["b"].observation.position
    assert opposed(noise) == pytest.approx(-0.75, abs=0.02)
    swing = compared(0.0, 1e-3, missing=missing, period=3.3)["b"].observation.position
    assert opposed(swing) == pytest.approx(np.cos(2.0 * np.pi / 3.3), abs=0.03)
    assert opposed(np.full((9, 2, 3), np.nan)) == 0.0


def test_what_was_hardly_measured_says_nothing() -> None:
    item = compared(3e-4, 0.0)["b"]
    item.observation.position[::3] = np.nan
    assert jumps(item.observation.position) == 0.0 and doubted_sigma({"b": item}) == []
    item.observation.position[:] = np.nan
    assert doubted_sigma({"b": item}) == []


def test_a_few_frames_are_pictured_without_a_word() -> None:
    item = replace(compared(1e-4, 1e-3)["b"], fit=(0, 3), predict=(3, 3))
    figure = sequence_figure(item, name="b", fps=60.0, at=np.zeros((MARKERS, 3)), parts=["part0"])
    # No spectrum of three frames, and so no legend of it: matplotlib warns of an empty one.
    (spectrum,) = [axes for axes in figure.axes if axes.get_title().startswith("spectrum")]
    assert not spectrum.lines and spectrum.get_legend() is None


def test_a_mean_of_nothing_is_nothing() -> None:
    values = np.array([[1.0, np.nan], [3.0, np.nan]])
    assert np.array_equal(mean_seen(values, 0), [2.0, np.nan], equal_nan=True)
    assert np.array_equal(mean_seen(values, 1), [1.0, 3.0])
