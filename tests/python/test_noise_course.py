"""Noise that is not the same in all frames is weighed as it is."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from mphygs.capture.json_values import plain
from mphygs.compare.assess import Compared
from mphygs.compare.metrics import sequence_errors
from mphygs.compare.noise import noise_document, noise_lines, observe
from mphygs.compare.noise_course import noise_course
from mphygs.compare.whitening import NoiseModel, Whitener
from mphygs.simulate.prediction import Predictor, Settings
from test_compare_noise import shaken_bar

FRAMES, MARKERS, FPS, SIGMA = 80, 40, 60.0, 2e-4
TIME = np.arange(FRAMES) / FPS
GROWING = np.linspace(1.0, 4.0, FRAMES) / np.sqrt(np.mean(np.linspace(1.0, 4.0, FRAMES) ** 2))


def swinging(seed: int, *, begins: int = 0, frequency: float = 2.0, damped: float = 0.0) -> np.ndarray:
    """(T, M, 3) true places of markers that swing in two ways from frame `begins` on."""
    rng = np.random.default_rng(seed)
    late = np.maximum(TIME - begins / FPS, 0.0)
    phases = 2.0 * np.pi * np.outer([frequency, 2.3 * frequency], late)
    ways = np.exp(-damped * late) * np.sin(phases)
    return 0.01 * np.einsum("kt,kmc->tmc", ways, rng.uniform(-1.0, 1.0, (2, MARKERS, 3)))


def noise(seed: int, course: np.ndarray | float = 1.0, heavy: bool = False) -> np.ndarray:
    rng = np.random.default_rng(1000 + seed)
    shape = (FRAMES, MARKERS, 3)
    own = rng.standard_t(4, shape) / np.sqrt(2.0) if heavy else rng.standard_normal(shape)
    return SIGMA * own * (course if np.isscalar(course) else course[:, None, None])


@pytest.mark.parametrize("seed", range(4))
def test_noise_that_grows_is_seen_frame_by_frame(seed: int) -> None:
    position = swinging(seed) + noise(seed, GROWING)
    position[np.random.default_rng(seed).random(position.shape[:2]) < 0.02] = np.nan
    course = noise_course(position)
    assert course is not None and np.mean(course**2) == pytest.approx(1.0)
    assert np.abs(np.log(course / GROWING)).max() < 0.35
    assert np.abs(np.log(course / GROWING))[12:68].max() < 0.15


def test_noise_that_is_worse_for_a_while_is_seen_there() -> None:
    worse = np.where((TIME > 0.5) & (TIME < 1.0), 3.0, 1.0)
    course = noise_course(swinging(1) + noise(1, worse))
    assert course is not None
    assert course[40:50].mean() > 1.8 * course[:20].mean() and course[40:50].mean() > 1.8 * course[70:].mean()


@pytest.mark.parametrize(
    ("motion", "heavy"),
    [
        ({}, False),
        ({}, True),
        ({"begins": 40}, False),  # a motion that begins is no noise that does
        ({"begins": 30, "frequency": 8.0}, False),
        ({"begins": 20, "frequency": 12.0, "damped": 6.0}, False),
    ],
)
def test_equal_noise_has_no_course_whatever_moves(motion: dict[str, float], heavy: bool) -> None:
    for seed in range(6):
        assert noise_course(swinging(seed, **motion) + noise(seed, heavy=heavy)) is None


def test_too_few_frames_or_markers_tell_nothing() -> None:
    position = swinging(0) + noise(0, GROWING)
    assert noise_course(position[:40]) is None
    assert noise_course(position[:, :4]) is None


def test_whitening_by_frames_gives_rows_of_one_and_its_own_adjoint() -> None:
    observed = np.random.default_rng(0).random((FRAMES, MARKERS)) > 0.05
    model = replace(NoiseModel.white(SIGMA, "stated"), common_sigma=np.asarray(0.5 * SIGMA))
    whitener = Whitener(model, observed, course=GROWING)
    shared = SIGMA * 0.5 * np.random.default_rng(5).standard_normal((FRAMES, 1, 3)) * GROWING[:, None, None]
    rows = whitener.whiten(noise(3, GROWING) + shared)
    for half in (whitener.frame < 40, whitener.frame >= 40):
        assert np.mean(rows[half] ** 2) == pytest.approx(1.0, abs=0.05)
    other = np.random.default_rng(1).standard_normal(len(rows))
    array = np.random.default_rng(2).standard_normal((FRAMES, MARKERS, 3))
    assert whitener.whiten(array) @ other == pytest.approx((whitener.whiten_transposed(other) * array).sum())
    with pytest.raises(ValueError, match="course"):
        Whitener(model, observed, course=np.ones(3))


def test_errors_of_frames_are_over_the_noise_of_these_frames() -> None:
    capture = shaken_bar(FRAMES)
    recording = capture.sequences[0]
    predictor = Predictor(capture, recording, Settings(0.015, workers=1))
    true = swinging(2)
    at = np.resize(recording.markers.at, (MARKERS, 3))
    markers = replace(recording.markers, at=at, position=true + noise(2, GROWING), sigma=SIGMA)
    free = replace(predictor.attachment, hold=np.full(MARKERS, -1))
    seen = observe(replace(recording, markers=markers), free)
    assert seen.course is not None
    white = seen.whitener(0, FRAMES)
    rows = white.whiten(markers.position - true)
    for part in (white.frame < 20, white.frame >= 60):
        assert np.mean(rows[part] ** 2) == pytest.approx(1.0, abs=0.25)
    document = plain(noise_document({"a": seen}))
    assert document["a"]["lowest"] < 0.6 * SIGMA and document["a"]["highest"] > 1.3 * SIGMA
    assert "changes over the frames" in noise_lines(document)[0]
    assert json.loads(json.dumps(document)) == document
    compared = Compared(seen, true, np.zeros((*true.shape, 0)), np.zeros(MARKERS, int), (0, 50), (50, 80))
    errors = sequence_errors({"a": compared}, {"a": seen.sigma})["a"]
    for label in ("fit", "predict", "all"):
        assert errors[label]["rms_over_sigma"] == pytest.approx(1.0, abs=0.08)
    assert errors["predict"]["rms"] > 1.4 * errors["fit"]["rms"]
