"""Whitening against dense covariances, and the noise learnt from footage at rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.stats import chi2

from mphygs.compare.autoregression import Autoregression, GapWhitener
from mphygs.compare.whitening import MINIMUM_REST_FRAMES, NoiseModel, Whitener, noise_from_rest


def correlated_noise(
    generator: np.random.Generator, coefficient: float, frames: int, shape: tuple[int, ...]
) -> np.ndarray:
    noise = generator.normal(size=(frames, *shape))
    for t in range(1, frames):
        noise[t] = coefficient * noise[t - 1] + np.sqrt(1.0 - coefficient**2) * noise[t]
    return noise


def mixed_model() -> NoiseModel:
    return NoiseModel(
        sigma=np.array([1.0, 1.0, 2.0, 0.5]),
        correlated_share=np.array([1.0, 0.0, 0.5, 0.7]),
        source="test",
        correlation=Autoregression((0.6, 0.2)),
        common_sigma=np.array([0.8, 0.0, 0.3]),
        common_correlation=Autoregression((0.5,)),
    )


def dense_covariance(noise: NoiseModel, whitener: Whitener) -> np.ndarray:
    frame, marker, coordinate = whitener.frame, whitener.marker, whitener.coordinate
    frames = whitener.observed.shape[0]
    lag = toeplitz(noise.correlation.autocorrelation(frames))[np.ix_(frame, frame)]
    common_lag = toeplitz(noise.common_correlation.autocorrelation(frames))[np.ix_(frame, frame)]
    variance, share = noise.sigma[marker] ** 2, noise.correlated_share[marker]
    own = variance * (share * lag + (1.0 - share) * (frame[:, None] == frame))
    same_coordinate = coordinate[:, None] == coordinate
    common = np.broadcast_to(noise.common_sigma, (3,))[coordinate] ** 2 * common_lag
    return same_coordinate * (own * (marker[:, None] == marker) + common)


def test_partial_autocorrelations_give_a_stationary_process_with_those_partials() -> None:
    process = Autoregression.from_partial([0.9, -0.5, 0.3])
    assert process.coefficients[-1] == pytest.approx(0.3)
    values = process.autocorrelation(200)
    # Yule-Walker: the process reproduces its own coefficients from its autocorrelation.
    solved = np.linalg.solve(toeplitz(values[:3]), values[1:4])
    np.testing.assert_allclose(solved, process.coefficients, atol=1e-12)
    assert abs(values[-1]) < 1e-3
    with pytest.raises(ValueError, match="stationary"):
        Autoregression((1.2,))


def test_gap_whitener_is_the_inverse_cholesky_factor_of_the_observed_covariance() -> None:
    generator = np.random.default_rng(0)
    process = Autoregression((0.5, 0.3, -0.2))
    observed = generator.random((40, 3)) > 0.3
    process_std, white_std = np.array([1.0, 2.0, 0.5]), np.array([0.0, 0.3, 1.0])
    whitener = GapWhitener(process, process_std, white_std, observed)
    array = generator.normal(size=(40, 3, 3, 2))
    whitened = whitener.whiten(array)
    for m in range(3):
        seen = observed[:, m]
        covariance = process_std[m] ** 2 * toeplitz(process.autocorrelation(40)) + white_std[m] ** 2 * np.eye(
            40
        )
        factor = np.linalg.cholesky(covariance[np.ix_(seen, seen)])
        expected = np.linalg.solve(factor, array[seen, m].reshape(seen.sum(), -1))
        np.testing.assert_allclose(whitened[seen, m].reshape(seen.sum(), -1), expected, atol=1e-12)
        assert not whitened[~seen, m].any()
        assert whitener.log_determinant[m] == pytest.approx(np.log(np.diag(factor)).sum())
    other = generator.normal(size=array.shape)
    assert (whitened * other).sum() == pytest.approx((array * whitener.whiten_transposed(other)).sum())


def test_whitener_with_gaps_unequal_markers_and_common_jitter_inverts_the_dense_covariance() -> None:
    noise = mixed_model()
    observed = np.random.default_rng(1).random((25, 4)) > 0.25
    observed[5] = False
    whitener = Whitener(noise, observed)
    count = whitener.row_count
    unit = np.zeros((25, 4, 3, count))
    unit[whitener.frame, whitener.marker, whitener.coordinate, np.arange(count)] = 1.0
    unit[~observed] = np.nan  # what was not measured must not matter
    matrix = whitener.whiten(unit)
    covariance = dense_covariance(noise, whitener)
    np.testing.assert_allclose(matrix @ covariance @ matrix.T, np.eye(count), atol=1e-11)
    np.testing.assert_allclose(whitener.whiten(unit[..., 0]), matrix[:, 0], atol=1e-13)
    np.testing.assert_allclose(noise.whiten(unit[..., 3], observed), matrix[:, 3], atol=1e-13)


def test_stated_sigma_alone_is_white() -> None:
    noise = noise_from_rest(None, 2e-4)
    array = np.random.default_rng(2).normal(size=(7, 3, 3))
    observed = np.ones((7, 3), bool)
    np.testing.assert_allclose(noise.whiten(array, observed), array.reshape(-1) / 2e-4)
    short = noise_from_rest(array[: MINIMUM_REST_FRAMES - 1], 2e-4)
    assert short.correlation.order == 0 and "too few" in short.source


def test_white_rest_is_called_white_and_short_correlated_rest_is_recovered_without_bias() -> None:
    generator = np.random.default_rng(3)
    white_orders = [
        noise_from_rest(generator.normal(size=(40, 6, 3)), None).correlation.order for _ in range(15)
    ]
    assert sum(order > 0 for order in white_orders) <= 1
    sums, sigmas = [], []
    for _ in range(15):
        noise = noise_from_rest(correlated_noise(generator, 0.8, MINIMUM_REST_FRAMES, (6, 3)), None)
        sums.append(sum(noise.correlation.coefficients))
        sigmas.append(np.mean(noise.sigma))
    # Removing each coordinate's mean without the restricted likelihood would bias this by about -0.15.
    assert np.mean(sums) == pytest.approx(0.8, abs=0.05)
    assert np.mean(sigmas) == pytest.approx(1.0, abs=0.08)


def test_scale_at_rest_raises_the_stated_sigma_but_does_not_lower_it() -> None:
    generator = np.random.default_rng(4)
    rest = correlated_noise(generator, 0.7, 60, (5, 3)) * np.array([1.0, 1.0, 6.0, 1.0, 0.2])[:, None] * 1e-4
    rest[10:15, 1] = np.nan
    noise = noise_from_rest(rest, 1e-4)
    assert noise.sigma[2] == pytest.approx(6e-4, rel=0.3)
    np.testing.assert_allclose(noise.sigma[[0, 1, 3, 4]], 1e-4)
    assert noise.correlated_share[4] == pytest.approx(0.04, rel=0.6)
    np.testing.assert_allclose(noise.correlated_share[:4], 1.0)
    assert noise_from_rest(rest, None).sigma[4] == pytest.approx(0.2e-4, rel=0.3)


def test_common_jitter_is_found_when_there_and_only_then() -> None:
    generator = np.random.default_rng(5)
    false_alarms = sum(
        noise_from_rest(generator.normal(size=(40, 8, 3)), 1.0).common_sigma.any() for _ in range(20)
    )
    assert false_alarms == 0
    rest = generator.normal(size=(80, 12, 3)) + correlated_noise(generator, 0.6, 80, (1, 3)) * [0.8, 0.0, 0.5]
    noise = noise_from_rest(rest, None)
    np.testing.assert_allclose(noise.common_sigma, [0.8, 0.0, 0.5], atol=0.2)
    assert noise.common_correlation.order >= 1
    assert np.mean(noise.sigma) == pytest.approx(1.0, abs=0.05)
    whitened = noise.whiten(rest - rest.mean(0), np.ones((80, 12), bool))
    assert (whitened**2).sum() == pytest.approx(whitened.size, rel=0.06)


def test_white_treatment_of_correlated_noise_raises_false_alarms_and_whitening_does_not() -> None:
    """The toy case of the method: slow candidates on AR(1) noise, tested one at a time at 5 %."""
    generator = np.random.default_rng(6)
    frames, markers = 60, 4
    time = np.linspace(0.0, 1.0, frames)
    tangents = np.stack([np.sin(np.pi * k * time) for k in (1, 2, 3)], -1)
    full = np.broadcast_to(tangents[:, None, None, :], (frames, markers, 3, 3))
    observed = generator.random((frames, markers)) > 0.1
    alarms = {"white": 0, "whitened": 0}
    draws = 30
    for _ in range(draws):
        noise = correlated_noise(generator, 0.85, frames, (markers, 3)) * 1e-4
        rest = correlated_noise(generator, 0.85, 40, (markers, 3)) * 1e-4
        for name, model in (
            ("white", noise_from_rest(None, 1e-4)),
            ("whitened", noise_from_rest(rest, 1e-4)),
        ):
            whitener = Whitener(model, observed)
            residual, columns = whitener.whiten(noise), whitener.whiten(full)
            score = (columns.T @ residual) ** 2 / (columns**2).sum(0)
            alarms[name] += int((chi2.sf(score, 1) < 0.05).sum())
    assert alarms["white"] > 0.3 * 3 * draws
    assert alarms["whitened"] < 0.1 * 3 * draws


def test_a_measured_scale_whitens_to_one_on_average_and_says_how_well_it_is_known() -> None:
    generator = np.random.default_rng(7)
    scale = np.array([1.0, 1.0, 5.0, 0.2])[:, None]
    ratios = []
    for _ in range(40):
        noise = noise_from_rest(generator.normal(size=(MINIMUM_REST_FRAMES, 4, 3)) * scale, None)
        # Expected chi² per observation given this estimate; the scale is known to about 2 / scale_degrees.
        ratios.append(np.mean(scale[:, 0] ** 2 / noise.sigma**2))
        assert noise.scale_degrees == pytest.approx(4 * 3 * (MINIMUM_REST_FRAMES - 1))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)
    assert np.std(ratios) == pytest.approx(np.sqrt(2.0 / noise.scale_degrees), rel=0.4)
    assert noise_from_rest(generator.normal(size=(40, 4, 3)), 1.0).scale_degrees == np.inf


def test_rest_of_the_recorded_beam_is_correlated_and_unequal() -> None:
    path = Path(__file__).parents[3] / "shared" / "data" / "silicone-beam" / "beam_gravity_V2_a.c3d"
    if not path.exists():
        pytest.skip("the recorded beam is not beside the repository")
    ezc3d = pytest.importorskip("ezc3d")
    rest = np.moveaxis(ezc3d.c3d(str(path))["data"]["points"][:3], -1, 0).transpose(0, 2, 1)[:68]
    measured = noise_from_rest(rest, None)
    # The second base marker flickers by 0.14 mm, the others by 0.01 to 0.05 mm.
    assert np.argmax(measured.sigma) == 4 and measured.sigma[4] == pytest.approx(1.4e-4, rel=0.2)
    assert measured.sigma[[0, 1, 2, 3, 5]].max() < 6e-5
    assert measured.correlation.autocorrelation(2)[1] > 0.7
    stated = noise_from_rest(rest, 2e-4)
    np.testing.assert_allclose(stated.sigma, 2e-4)
    assert stated.correlated_share[0] < 0.02 < 0.3 < stated.correlated_share[4]


def test_bad_input_is_named() -> None:
    noise = NoiseModel.white(1.0, "test")
    array = np.zeros((4, 2, 3))
    array[2, 1, 0] = np.nan
    with pytest.raises(ValueError, match="frame 2, marker 1"):
        noise.whiten(array, np.ones((4, 2), bool))
    with pytest.raises(ValueError, match="expected footage at rest or a stated sigma"):
        noise_from_rest(None, None)
    with pytest.raises(ValueError, match="positive"):
        NoiseModel.white(0.0, "test")
