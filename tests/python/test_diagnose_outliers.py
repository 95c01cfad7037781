"""Bad tracks against misfits that physics makes."""

import numpy as np
import pytest

from mphygs.diagnose.outliers import bad_observations

SIGMA, FRAMES = 2e-4, 60


@pytest.fixture
def surface() -> np.ndarray:
    """(M, 3) markers on a strip [m]."""
    x, y = np.meshgrid(np.linspace(0, 0.1, 21), np.linspace(0, 0.02, 5), indexing="ij")
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])


def noise(surface: np.ndarray, seed: int = 0) -> np.ndarray:
    return SIGMA * np.random.default_rng(seed).standard_normal((FRAMES, len(surface), 3))


def swing(surface: np.ndarray, size: float) -> np.ndarray:
    """Misfit of a cantilever whose effect is missing: grows along it, swings, bends. (T, M, 3) [m]"""
    t = np.arange(FRAMES)[:, None]
    along = (surface[:, 0] / 0.1)[None]
    out = np.zeros((FRAMES, len(surface), 3))
    out[..., 2] = size * along**2 * np.sin(0.4 * t)
    out[..., 0] = 0.5 * size * along**2 * np.sin(0.8 * t) * surface[None, :, 1] / 0.02
    return out


def test_noise_alone_is_kept(surface: np.ndarray) -> None:
    assert not bad_observations(noise(surface), surface, SIGMA).any()


@pytest.mark.parametrize("size", [0.002, 0.02, 0.1])
def test_a_missing_effect_is_no_bad_track(surface: np.ndarray, size: float) -> None:
    assert not bad_observations(noise(surface) + swing(surface, size), surface, SIGMA).any()


@pytest.mark.parametrize("size", [0.0, 0.002])
def test_lost_tracks_are_left_out_whole(surface: np.ndarray, size: float) -> None:
    lost = [12, 47, 80]
    walk = np.cumsum(2e-3 * np.random.default_rng(1).standard_normal((FRAMES, 3, 3)), axis=0)
    residual = noise(surface) + swing(surface, size)
    residual[:, lost] += walk
    bad = bad_observations(residual, surface, SIGMA)
    assert bad[:, lost].all()
    assert not np.delete(bad, lost, axis=1).any()


def test_single_wrong_measurements_are_left_out_alone(surface: np.ndarray) -> None:
    generator = np.random.default_rng(2)
    residual = noise(surface) + swing(surface, 0.002)
    wrong = generator.random((FRAMES, len(surface))) < 0.01
    residual[wrong] += 0.02
    bad = bad_observations(residual, surface, SIGMA)
    assert bad[wrong].mean() > 0.9
    assert not bad[~wrong].any()


def test_too_few_markers_say_nothing(surface: np.ndarray) -> None:
    assert not bad_observations(noise(surface)[:, :6], surface[:6], SIGMA).any()
