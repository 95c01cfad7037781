"""Marker places, and the statistics of noise and loss."""

import numpy as np
import pytest

from mphygs.scene.particles import closest_material, inside
from mphygs.synth.marker_noise import Noise, measure, place_markers
from mphygs.synth.shapes import flower, two_part_bar

STILL = np.zeros((400, 60, 3))


def lag_one(noise: np.ndarray) -> float:
    return float(np.mean(noise[1:] * noise[:-1]) / np.mean(noise**2))


def common(noise: np.ndarray) -> float:
    """Share of the variance that all markers of a frame have together."""
    return float(np.mean(noise.mean(axis=1) ** 2) / np.mean(noise**2))


def drawn(**values: object) -> np.ndarray:
    settings = {"sigma": 3e-4, "dropout": 0.0} | values
    return measure(STILL, Noise(**settings), np.random.default_rng(5))


def test_white_noise_has_its_sigma_and_no_memory() -> None:
    noise = drawn(kind="white")
    assert noise.std() == pytest.approx(3e-4, rel=0.02)
    assert abs(lag_one(noise)) < 0.02
    assert common(noise) == pytest.approx(1.0 / 60.0, rel=0.15)


def test_correlated_noise_has_its_sigma_and_memory() -> None:
    noise = drawn(kind="correlated", share=0.6, correlation=0.8)
    assert noise.std() == pytest.approx(3e-4, rel=0.03)
    assert lag_one(noise) == pytest.approx(0.6 * 0.8, abs=0.03)
    assert common(noise) == pytest.approx(1.0 / 60.0, rel=0.2)


def test_jitter_moves_all_markers_of_a_frame_together() -> None:
    noise = drawn(kind="jitter", share=0.5)
    assert noise.std() == pytest.approx(3e-4, rel=0.05)
    assert common(noise) == pytest.approx(0.5, abs=0.05)
    assert abs(lag_one(noise)) < 0.06


def test_rounded_noise_stands_on_a_grid_and_has_its_sigma() -> None:
    noise = drawn(kind="rounded", share=0.5)
    step = 3e-4 * np.sqrt(6.0)
    np.testing.assert_allclose(noise / step, np.round(noise / step), atol=1e-9)
    # Rounding adds a twelfth of the step's square where values are spread over steps.
    spread = np.random.default_rng(1).uniform(0.0, 1.0, STILL.shape)
    measured = measure(spread, Noise("rounded", 3e-4, dropout=0.0), np.random.default_rng(5))
    assert (measured - spread).std() == pytest.approx(3e-4, rel=0.02)


def test_heavy_noise_has_its_sigma_and_tails() -> None:
    noise = drawn(kind="heavy")
    assert noise.std() == pytest.approx(3e-4, rel=0.05)
    assert (np.abs(noise) > 4.0 * 3e-4).mean() > 20.0 * 6.3e-5
    assert abs(lag_one(noise)) < 0.02


def test_growing_noise_grows_fourfold() -> None:
    noise = drawn(kind="growing")
    assert noise.std() == pytest.approx(3e-4, rel=0.02)
    assert noise[-20:].std() / noise[:20].std() == pytest.approx(4.0, rel=0.15)


def test_lost_values_are_missing_as_whole_points() -> None:
    noise = drawn(kind="white", dropout=0.1)
    lost = np.isnan(noise)
    assert (lost.any(axis=2) == lost.all(axis=2)).all()
    assert lost.mean() == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"kind": "pink"}, "expected one of white"),
        ({"sigma": 0.0}, "above 0"),
        ({"correlation": 1.0}, "below 1"),
        ({"dropout": -0.1}, "at least 0"),
    ],
)
def test_impossible_noise_is_refused(values, said) -> None:
    with pytest.raises(ValueError, match=said):
        Noise(**values)


@pytest.mark.parametrize("body", [two_part_bar(), flower()])
def test_half_the_markers_are_inside_and_half_on_the_surface(body) -> None:
    places = place_markers(body.parts, 60, np.random.default_rng(1))
    assert places.shape == (60, 3)
    assert np.abs(closest_material(body.parts, places).offset).max() < 1e-9
    for part in body.parts:
        low, high = part.bounds
        own = places[((places >= low - 1e-9) & (places <= high + 1e-9)).all(axis=1)]
        assert len(own) >= 4
        assert inside(part, own).sum() >= 2
    assert not np.allclose(places, place_markers(body.parts, 60, np.random.default_rng(2)))
    with pytest.raises(ValueError, match="at least"):
        place_markers(body.parts, 3, np.random.default_rng(1))
