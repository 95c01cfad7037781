"""Noise as tracks show it, whatever was stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mphygs.capture.track_faults.scatter import seen_sigma
from mphygs.compare.noise import noise_document, noise_lines, observe
from mphygs.simulate.prediction import Predictor, Settings
from test_compare_noise import shaken_bar

FRAMES, MARKERS, FPS = 60, 30, 60.0


def tracks(sigma: float, *, frequency: float = 3.0, seed: int = 0) -> np.ndarray:
    """(T, M, 3) of markers that swing by 20 mm, with noise and gaps."""
    rng = np.random.default_rng(seed)
    time = np.arange(FRAMES) / FPS
    swing = 0.02 * np.sin(2.0 * np.pi * frequency * time)[:, None, None] * rng.uniform(0.2, 1.0, (MARKERS, 3))
    position = swing + sigma * rng.normal(size=swing.shape)
    position[rng.uniform(size=position.shape[:2]) < 0.02] = np.nan
    return position


@pytest.mark.parametrize("sigma", [5e-5, 2e-4, 1e-3])
def test_noise_is_seen_beside_a_motion_far_larger(sigma: float) -> None:
    deviations = []
    for seed in range(20):
        seen = seen_sigma(tracks(sigma, seed=seed))
        if seen is not None:  # two orders agree by chance but for one case in some thousands
            deviations.append(np.log(seen.value / sigma) / seen.error)
    assert len(deviations) >= 18
    assert abs(np.mean(deviations)) < 1.0 and 0.5 < np.sqrt(np.mean(np.square(deviations))) < 1.5


def test_nothing_is_seen_of_fast_motion_or_of_short_tracks() -> None:
    assert seen_sigma(tracks(5e-5, frequency=14.0)) is None
    assert seen_sigma(tracks(2e-4)[:14]) is None


def test_a_few_that_jump_are_not_the_noise_of_the_others() -> None:
    position = tracks(2e-4)
    position[::7, :6] += 0.005
    assert seen_sigma(position).value == pytest.approx(2e-4, rel=0.2)


def test_what_was_stated_does_not_matter_where_the_tracks_tell() -> None:
    recording = shaken_bar(FRAMES).sequences[0]
    held = np.random.default_rng(4).uniform(size=(15, 3)) * [0.0, 0.015, 0.015]
    at = np.concatenate([held, held + [0.02, 0.0, 0.0]])
    times = np.arange(FRAMES) / FPS
    rotation, shift = recording.held[0].poses(times, FPS)
    position = np.einsum("tij,mj->tmi", rotation, at) + shift[:, None]
    position = position + 3e-4 * np.random.default_rng(3).standard_normal(position.shape)
    found = {}
    for sigma in (1.5e-4, 3e-4, 6e-4):
        markers = replace(recording.markers, at=at, position=position, sigma=sigma)
        stated = replace(recording, markers=markers)
        predictor = Predictor(shaken_bar(FRAMES), stated, Settings(0.015, workers=1))
        found[sigma] = observe(stated, predictor.attachment)
    for sigma, observation in found.items():
        np.testing.assert_array_equal(observation.noise.sigma, found[3e-4].noise.sigma)
        assert observation.sigma == pytest.approx(3e-4, rel=0.1)
        document = noise_document({"a": observation})
        assert document["a"]["stated"] == sigma and document["a"]["differs"] is (sigma != 3e-4)
        assert len(noise_lines(document)) == (sigma != 3e-4)
