"""Noise of what instruments measured, as stated and as seen, and the frames that are compared."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.capture.sensors import Sensor
from mphygs.compare.noise import observe
from mphygs.compare.sensor_residuals import seen_noise, sensor_observations, with_grid
from mphygs.fit.experiment import Experiment
from mphygs.simulate.instruments import compared_frames
from mphygs.simulate.settings import Settings
from sensor_example import acceleration_at, force_at, moved_bar, with_sensors

FRAMES = 240


def swinging(noise: float, seed: int = 0) -> np.ndarray:
    """A motion of ten frames a period and more, with noise, (T, 3)."""
    t = np.arange(FRAMES)[:, None]
    motion = np.sin(2.0 * np.pi * t / [20.0, 31.0, 55.0]) * [1.0, 0.3, 2.0]
    return motion + noise * np.random.default_rng(seed).standard_normal(motion.shape)


@pytest.mark.parametrize("noise", [0.02, 0.2])
def test_noise_is_seen_beside_a_motion(noise: float) -> None:
    found = [seen_noise(swinging(noise, seed)) for seed in range(20)]
    assert np.mean(found) == pytest.approx(noise, rel=0.1)
    gappy = swinging(noise)
    gappy[::17] = np.nan
    assert seen_noise(gappy) == pytest.approx(noise, rel=0.3)


def test_what_was_computed_keeps_a_little_noise() -> None:
    motion = swinging(0.0)
    size = np.sqrt(np.mean(motion**2))
    assert 1e-3 * size <= seen_noise(motion) < 0.02 * size


def test_a_stated_sigma_stays_and_an_absent_one_is_seen() -> None:
    value = np.stack([swinging(0.1), swinging(0.03)], axis=1)
    capture = bar_capture(frames=FRAMES)
    sensor = Sensor("force", value, np.array([0.5, np.nan]), hold=0)
    (found,) = sensor_observations(with_sensors(capture, sensor).sequences[0])
    assert found.sigma[0] == 0.5 and found.sigma[1] == pytest.approx(0.03, rel=0.25)
    assert "seen" in found.noise.source
    (stated,) = sensor_observations(
        with_sensors(capture, replace(sensor, sigma=np.array([0.5, 0.1]))).sequences[0]
    )
    assert stated.noise.source.startswith("stated")


def test_frames_that_no_model_tells_are_left_out() -> None:
    recording = replace(bar_capture(frames=12).sequences[0], release=5)
    force, tip = force_at(0, 12), acceleration_at([0.05, 0.01, 0.01], 12)
    assert np.flatnonzero(compared_frames(recording, force)).tolist() == [7, 8, 9, 10]
    assert np.flatnonzero(compared_frames(recording, tip)).tolist() == [1, 2, 3, 7, 8, 9, 10]
    plain = replace(recording, release=None)
    assert np.flatnonzero(compared_frames(plain, force)).tolist() == list(range(1, 11))
    (found,) = sensor_observations(replace(recording, sensors=(force,)))
    assert np.isfinite(found.value).all(axis=(1, 2)).sum() == 4 and found.whitener(0, 12).row_count == 24


def test_whitened_residuals_have_unit_variance_grid_included() -> None:
    sensor = Sensor("force", swinging(0.1)[:, None], np.array([0.1]), hold=0)
    (plain,) = sensor_observations(with_sensors(bar_capture(frames=FRAMES), sensor).sequences[0])
    clean = swinging(0.0)[:, None]
    assert np.std(plain.residual(clean, 0, FRAMES)) == pytest.approx(1.0, abs=0.08)
    error = 0.3 * np.random.default_rng(5).standard_normal((FRAMES, 1, 3))
    (counted,) = with_grid([plain], [error])
    assert counted.grid == pytest.approx(0.3, rel=0.1)
    assert np.std(counted.residual(clean + error, 0, FRAMES)) == pytest.approx(1.0, abs=0.08)


def test_the_grid_s_share_is_what_a_finer_one_would_change() -> None:
    frames = 16
    capture = moved_bar(frames, fit=(0, frames))
    belief = bar_belief(capture, youngs_modulus=2e5)
    experiment = Experiment.of(capture, Settings(0.01, workers=1))
    experiment.problem(0.01)
    name = capture.sequences[0].name
    assert all(np.all(s.grid == 0.0) for s in experiment.observations[name].sensors)
    experiment.refer(belief)
    coarse, fine = (experiment.predictor(name, h).predict(belief).readings for h in (0.01, 0.005))
    for sensor, a, b in zip(experiment.observations[name].sensors, coarse, fine, strict=True):
        told = np.isfinite(sensor.value).all(2)
        for v in range(len(sensor.quantities)):
            change = (a.value - b.value)[told[:, v], v]
            assert 0.3 < sensor.grid[v] / np.sqrt(np.mean(change**2)) < 4.0
    again = observe(capture.sequences[0], experiment.predictor(name, 0.01).attachment)
    assert again.sensors[0].value.shape == experiment.observations[name].sensors[0].value.shape
