"""Noise learned from markers that cannot move, where the measurement is at fault."""

from dataclasses import replace

import numpy as np
import pytest

from force_example import FPS, shaken_bar
from mphygs.compare.noise import observe, without_faults
from mphygs.compare.whitening import noise_from_rest
from mphygs.simulate.prediction import Predictor, Settings

FRAMES, SIGMA = 60, 5e-5
DRIFT = {"velocity": np.array([1e-3, -5e-4, 2e-4]), "turning": np.array([0.0, 0.02, 0.01])}


def seen(hold: str, faults: tuple[str, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
    """True positions of markers that follow a shaken hold or rest, and what is seen of them without noise."""
    random = np.random.default_rng(1)
    times = np.arange(FRAMES) / FPS
    rest = random.uniform(size=(15, 3)) * [0.02, 0.05, 0.05]

    def at(t: np.ndarray) -> np.ndarray:
        moved = 0.012 * np.sin(2 * np.pi * 1.5 * t)[:, None] * [0.0, 1.0, 0.4]
        return rest + (moved[:, None] if hold == "shaken" else np.zeros((len(t), 1, 3)))

    position = at(times + 0.003) if "late" in faults else at(times)
    if "drifting" in faults:
        turned = np.cross(DRIFT["turning"], position)
        position = position + times[:, None, None] * (DRIFT["velocity"] + turned)
    if "longer" in faults:
        position = position * 1.02
    return at(times), position


@pytest.mark.parametrize("faults", [("late",), ("drifting",), ("longer",), ("late", "longer", "drifting")])
@pytest.mark.parametrize("hold", ["shaken", "at rest"])
def test_faults_leave_nothing_on_markers_that_cannot_move(hold: str, faults: tuple[str, ...]) -> None:
    true, shown = seen(hold, faults)
    times = np.arange(FRAMES) / FPS
    left = without_faults(shown - true, times, true)
    before = np.abs(shown - true).max()
    if hold == "at rest" and faults == ("late",):
        assert before == 0.0 and not left.any()
    else:
        assert before > 3e-4 and np.abs(left).max() < 0.03 * before


def test_noise_stays_but_for_the_faults_own_numbers() -> None:
    true, _ = seen("shaken")
    noise = SIGMA * np.random.default_rng(2).standard_normal(true.shape)
    noise[5:9, 3] = np.nan
    left = without_faults(noise, np.arange(FRAMES) / FPS, true)
    assert (np.isnan(left) == np.isnan(noise)).all()
    count = np.isfinite(noise).sum()
    # What the nine numbers take, they take on average: the scale is that of the noise.
    assert np.nanmean(left**2) == pytest.approx(np.nanmean(noise**2), rel=2 * np.sqrt(2 * 9) / count)
    shares = [
        np.mean(without_faults(n, np.arange(FRAMES) / FPS, true[:, :2]) ** 2) / SIGMA**2
        for n in SIGMA * np.random.default_rng(6).standard_normal((200, FRAMES, 2, 3))
    ]
    assert np.mean(shares) == pytest.approx(1.0, abs=0.4 * 9 / (FRAMES * 2 * 3))
    few = without_faults(noise[:2, :2], np.arange(2) / FPS, true[:2, :2])
    np.testing.assert_array_equal(few, noise[:2, :2], "too few numbers to tell faults from noise")


@pytest.mark.parametrize("faults", [("late",), ("drifting",), ("longer",)])
def test_a_fault_is_not_learned_as_noise(faults: tuple[str, ...]) -> None:
    capture = shaken_bar(FRAMES)
    recording = capture.sequences[0]
    held = np.random.default_rng(4).uniform(size=(15, 3)) * [0.0, 0.015, 0.015]
    recording = replace(recording, markers=replace(recording.markers, at=held))
    predictor = Predictor(capture, recording, Settings(0.015, workers=1))
    times = np.arange(FRAMES) / FPS
    rotation, shift = recording.held[0].poses(times + (0.004 if "late" in faults else 0.0), FPS)
    at = recording.markers.at
    position = np.einsum("tij,mj->tmi", rotation, at) + shift[:, None]
    if "drifting" in faults:
        turned = np.cross(DRIFT["turning"], position)
        position = position + times[:, None, None] * (DRIFT["velocity"] + turned)
    if "longer" in faults:
        position = position * 1.02
    sigma = recording.markers.sigma
    position = position + sigma * np.random.default_rng(3).standard_normal(position.shape)
    markers = replace(recording.markers, position=position)
    noise = observe(replace(recording, markers=markers), predictor.attachment).noise
    assert "markers on what is held" in noise.source and "white" in noise.source
    assert not noise.common_sigma.any() and not noise.correlated_share.any()
    np.testing.assert_allclose(noise.sigma, sigma, rtol=0.12)  # as seen in so few series


@pytest.mark.parametrize(
    ("lasting", "size"),
    [
        # half of the variance lasts from frame to frame: differences see little of that
        (0.5, 1.0),
        # white, and half of what is stated: there differences see all
        (0.0, 0.5),
    ],
)
def test_noise_that_lasts_is_not_taken_for_little(lasting: float, size: float) -> None:
    capture = shaken_bar(FRAMES)
    recording = capture.sequences[0]
    random = np.random.default_rng(8)
    held = random.uniform(size=(24, 3)) * [0.0, 0.015, 0.015]
    recording = replace(recording, markers=replace(recording.markers, at=held))
    predictor = Predictor(capture, recording, Settings(0.015, workers=1))
    rotation, shift = recording.held[0].poses(np.arange(FRAMES) / FPS, FPS)
    still = np.einsum("tij,mj->tmi", rotation, held) + shift[:, None]
    drawn = random.standard_normal((2, FRAMES + 50, *held.shape))
    slow = np.zeros_like(drawn[0])
    for t in range(1, len(slow)):
        slow[t] = 0.9 * slow[t - 1] + np.sqrt(1 - 0.9**2) * drawn[0, t]
    sigma = recording.markers.sigma
    noise = size * sigma * (np.sqrt(lasting) * slow[50:] + np.sqrt(1 - lasting) * drawn[1, 50:])
    markers = replace(recording.markers, position=still + noise)
    found = observe(replace(recording, markers=markers), predictor.attachment).noise
    assert (found.correlation.order > 0) is (lasting > 0)
    np.testing.assert_allclose(found.sigma, size * sigma, rtol=0.12)


def test_points_at_rest_that_do_not_scatter_say_nothing_of_noise() -> None:
    still = np.ones((40, 5, 3))
    noise = noise_from_rest(still, 2e-4)
    assert noise.sigma == 2e-4 and "none of them with a noise" in noise.source
    one = still.copy()
    one[:, 2] += 1e-3 * np.random.default_rng(0).standard_normal((40, 3))
    assert noise_from_rest(one, 2e-4).sigma.max() == pytest.approx(1e-3, rel=0.3)
