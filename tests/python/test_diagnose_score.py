"""Score test: its law under the null, its estimates under the alternative, bounds, rank and absorption."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.stats import chi2, f, kstest

from mphygs.compare.allowance import Allowance, modulated_directions
from mphygs.compare.residual_projection import project_out
from mphygs.diagnose.cone import cone_maximum, cone_weights, mixture_p_value
from mphygs.diagnose.score import predicted_residual, score_candidates
from mphygs.diagnose.score_table import Candidate


def candidate(
    name: str, tangent: np.ndarray, bounded: bool | list[bool] = False, null: float = 0.0
) -> Candidate:
    tangent = np.asarray(tangent, dtype=float)
    tangent = tangent[:, None] if tangent.ndim == 1 else tangent
    count = tangent.shape[1]
    return Candidate(
        name=name, tangent=tangent, lower_bounded=np.broadcast_to(bounded, count), null=np.full(count, null)
    )


def toy(
    generator: np.random.Generator, observations: int = 120, parameters: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    jacobian = generator.normal(size=(observations, parameters))
    tangent = generator.normal(size=(observations, 3)) + 0.7 * jacobian[:, :1]
    return jacobian, tangent


def null_p_values(
    draws: int, build: Callable[[np.ndarray], list[Candidate]], *, sigma_known: bool = True
) -> np.ndarray:
    generator = np.random.default_rng(7)
    jacobian, tangent = toy(generator)
    candidates = build(tangent)
    values = []
    for _ in range(draws):
        residual = generator.standard_normal(len(jacobian))
        table = score_candidates(residual, jacobian, candidates, generator=generator, sigma_known=sigma_known)
        values.append([score.p_value for score in table.scores])
    return np.array(values)


def test_p_values_are_uniform_under_the_null() -> None:
    values = null_p_values(400, lambda t: [candidate("one", t[:, 0]), candidate("three", t)])
    for column in values.T:
        assert kstest(column, "uniform").pvalue > 0.01
    unknown = null_p_values(400, lambda t: [candidate("three", t * 5.0)], sigma_known=False)
    assert kstest(unknown[:, 0], "uniform").pvalue > 0.01


def test_one_sided_p_values_are_half_one_and_half_uniform_below_a_half() -> None:
    values = null_p_values(400, lambda t: [candidate("one", t[:, 0], bounded=True)])[:, 0]
    assert np.mean(values == 1.0) == pytest.approx(0.5, abs=0.08)
    assert values[values < 1.0].max() <= 0.5
    assert kstest(values[values < 1.0] * 2.0, "uniform").pvalue > 0.01


def test_the_exact_one_sided_and_f_formulas() -> None:
    generator = np.random.default_rng(8)
    jacobian, tangent = toy(generator)
    residual = generator.standard_normal(120) + 0.3 * tangent[:, 0]
    pair = [candidate("up", tangent[:, 0], bounded=True), candidate("down", -tangent[:, 0], bounded=True)]
    table = score_candidates(residual, jacobian, pair, generator=generator)
    assert table["up"].p_value == pytest.approx(0.5 * chi2.sf(table["up"].statistic, 1))
    assert table["down"].p_value == 1.0 and table["down"].drop == 0.0 and table["down"].estimate[0] == 0.0
    assert table["down"].unbounded[0] == pytest.approx(-table["up"].estimate[0])
    free = [candidate("three", tangent)]
    unknown = score_candidates(residual, jacobian, free, generator=generator, sigma_known=False)["three"]
    full = np.hstack([jacobian, tangent])
    left = residual - full @ np.linalg.lstsq(full, residual, rcond=None)[0]
    before = residual - jacobian @ np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    statistic = (before @ before - left @ left) / 3 / (left @ left / (120 - 3 - 3))
    assert unknown.p_value == pytest.approx(f.sf(statistic, 3, 114), rel=1e-9)


def test_drop_estimate_shift_and_residual_are_those_of_a_least_squares_refit() -> None:
    generator = np.random.default_rng(9)
    jacobian, tangent = toy(generator)
    residual = generator.standard_normal(120) + tangent @ [0.5, 0.0, -0.4]
    residual -= jacobian @ np.linalg.lstsq(jacobian, residual, rcond=None)[0]
    score = score_candidates(residual, jacobian, [candidate("e", tangent, null=2.0)], generator=generator)[
        "e"
    ]
    full = np.hstack([jacobian, tangent])
    solution, *_ = np.linalg.lstsq(full, residual, rcond=None)
    left = residual - full @ solution
    assert score.drop == pytest.approx(residual @ residual - left @ left)
    np.testing.assert_allclose(score.estimate, 2.0 + solution[3:], rtol=1e-9)
    np.testing.assert_allclose(score.shift, solution[:3], rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(
        predicted_residual(residual, jacobian, tangent, increment=score.estimate - 2.0, shift=score.shift),
        left,
    )
    assert score.expected_chi_square == pytest.approx(left @ left)
    assert score.expected_rms == pytest.approx(np.sqrt(np.mean(left**2)))


def test_estimate_is_unbiased_with_the_stated_deviation_whatever_the_allowance() -> None:
    generator = np.random.default_rng(10)
    jacobian, tangent = toy(generator)
    truth = np.array([0.3, -0.2, 0.1])
    for variance in (0.0, 3.0):
        errors = []
        for _ in range(300):
            noise = generator.standard_normal(120) * np.sqrt(1.0 + variance)
            table = score_candidates(
                noise + tangent @ truth,
                jacobian,
                [candidate("e", tangent)],
                generator=generator,
                allowance=Allowance(variance=np.asarray(variance)),
            )
            errors.append((table["e"].estimate - truth) / table["e"].std)
        assert np.abs(np.mean(errors, 0)).max() < 0.2
        np.testing.assert_allclose(np.std(errors, 0), 1.0, atol=0.13)


def test_cone_maximum_is_the_bounded_least_squares_solution() -> None:
    generator = np.random.default_rng(11)
    for bounded in ([True, False, True, True], [True] * 8):
        bounded = np.array(bounded)
        root = generator.normal(size=(len(bounded), len(bounded)))
        scores = generator.normal(size=(20, len(bounded))) @ root
        gain, estimate, dimension = cone_maximum(scores, root.T @ root, bounded)
        for i, score in enumerate(scores):
            target = np.linalg.solve(root.T, score)
            expected = lsq_linear(root, target, (np.where(bounded, 0.0, -np.inf), np.inf), tol=1e-14)
            np.testing.assert_allclose(estimate[i], expected.x, atol=1e-5)
            assert gain[i] == pytest.approx(target @ target - 2.0 * expected.cost, abs=1e-8)
            assert dimension[i] == (~bounded).sum() + (estimate[i][bounded] > 0.0).sum()


def test_chi_bar_square_agrees_with_simulation_and_with_the_exact_angle() -> None:
    generator = np.random.default_rng(12)
    information = np.array([[1.0, 0.6, 0.2], [0.6, 1.0, -0.3], [0.2, -0.3, 1.0]])
    bounded = np.array([True, True, False])
    weights = cone_weights(information, bounded, generator)
    schur = information[:2, :2] - np.outer(information[:2, 2], information[2, :2])
    correlation = schur[0, 1] / np.sqrt(schur[0, 0] * schur[1, 1])
    # Both free: both components of inverse(schur) u positive, correlated by -correlation.
    both = 0.25 + np.arcsin(-correlation) / (2.0 * np.pi)
    np.testing.assert_allclose(weights, [0.0, 0.5 - both, 0.5, both], atol=0.03)
    draws = generator.standard_normal((20000, 3)) @ np.linalg.cholesky(information).T
    gain, _, _ = cone_maximum(draws, information, bounded)
    for level in (1.0, 4.0, 8.0):
        assert mixture_p_value(level, weights) == pytest.approx(np.mean(gain >= level), rel=0.1)
    assert mixture_p_value(0.0, weights) == 1.0


def test_bounded_candidate_with_several_parameters_has_uniform_small_p_values() -> None:
    values = null_p_values(300, lambda t: [candidate("three", t, bounded=[True, True, False])])[:, 0]
    for level in (0.05, 0.2, 0.5):
        assert np.mean(values <= level) == pytest.approx(level, abs=3.0 * np.sqrt(level * (1 - level) / 300))


def test_absorbed_dead_and_dependent_candidates() -> None:
    generator = np.random.default_rng(13)
    jacobian, tangent = toy(generator)
    nearly = jacobian @ [1.0, -2.0, 0.5] + 1e-2 * tangent[:, 0]
    twice = np.stack([tangent[:, 0], 3.0 * tangent[:, 0]], 1)
    partly = np.stack([tangent[:, 1], jacobian[:, 0]], 1)
    residual = generator.standard_normal(120) + tangent[:, 0] + tangent[:, 1]
    table = score_candidates(
        residual,
        jacobian,
        generator=generator,
        candidates=[
            candidate("absorbed", nearly),
            candidate("dead", np.zeros(120)),
            candidate("twice", twice),
            candidate("single", tangent[:, 0]),
            candidate("partly", partly, bounded=True),
            candidate("second", tangent[:, 1], bounded=True),
        ],
    )
    assert not table["absorbed"].testable and "absorb" in table["absorbed"].reason
    assert table["absorbed"].absorbed_share > 0.999
    assert not table["dead"].testable and "does not move" in table["dead"].reason
    assert table["dead"].p_value == 1.0 and table["dead"].absorbed_share == 1.0
    assert table["twice"].drop == pytest.approx(table["single"].drop)
    assert table["twice"].p_value == pytest.approx(table["single"].p_value)
    assert np.isinf(table["twice"].std).all()
    assert table["partly"].drop == pytest.approx(table["second"].drop)
    assert np.isinf(table["partly"].std[1]) and table["partly"].absorbed[1] == pytest.approx(1.0)
    assert {score.name for score in table.ranked()} == {"twice", "single", "partly", "second"}
    residuals = residual - project_out(tangent[:, :1]).remaining(residual)
    assert residuals @ tangent[:, 0] == pytest.approx(residual @ tangent[:, 0])


def test_a_nearly_absorbed_direction_leaves_the_score_and_the_joint_matrices() -> None:
    generator = np.random.default_rng(19)
    jacobian, tangent = toy(generator)
    nearly = jacobian[:, 1] + 1e-2 * tangent[:, 2]
    effect = candidate("e", np.stack([tangent[:, 0], nearly], 1), bounded=[False, True])
    residual = generator.standard_normal(120) + tangent[:, 0] + 2.0 * tangent[:, 2]
    table = score_candidates(residual, jacobian, [effect], generator=generator)
    assert np.isinf(table["e"].std[1])
    values, vectors = np.linalg.eigh(table.joint_information)
    assert values[0] < 1e-12 * values[1]
    assert abs(vectors[:, 0] @ table.joint_score) < 1e-6 * np.linalg.norm(table.joint_score)


def test_dependent_parameters_are_counted_once() -> None:
    generator = np.random.default_rng(14)
    jacobian, tangent = toy(generator)
    doubled = np.hstack([jacobian * [1e6, 1.0, 1e-6], jacobian[:, :1] + jacobian[:, 1:2], np.zeros((120, 1))])
    residual = generator.standard_normal(120) + tangent[:, 0]
    plain = score_candidates(residual, jacobian, [candidate("e", tangent)], generator=generator)
    again = score_candidates(residual, doubled, [candidate("e", tangent)], generator=generator)
    assert plain.degrees == again.degrees == 117
    assert again["e"].drop == pytest.approx(plain["e"].drop)
    np.testing.assert_allclose(doubled @ again["e"].shift, jacobian @ plain["e"].shift, atol=1e-9)
    assert again["e"].shift[4] == 0.0


def test_directions_of_the_allowance_give_the_tests_of_the_full_covariance() -> None:
    generator = np.random.default_rng(15)
    jacobian, tangent = toy(generator)
    directions, variance = 2.0 * generator.normal(size=(120, 4)), generator.random(120)
    residual = generator.standard_normal(120) + tangent[:, 0]
    table = score_candidates(
        residual,
        jacobian,
        [candidate("e", tangent)],
        generator=generator,
        allowance=Allowance(variance=variance, directions=directions),
    )
    inverse = np.linalg.inv(np.diag(1.0 + variance) + directions @ directions.T)

    def misfit(columns: np.ndarray) -> tuple[float, np.ndarray]:
        solution = np.linalg.solve(columns.T @ inverse @ columns, columns.T @ inverse @ residual)
        left = residual - columns @ solution
        return left @ inverse @ left, solution

    before, _ = misfit(jacobian)
    after, solution = misfit(np.hstack([jacobian, tangent]))
    assert table.chi_square == pytest.approx(before) and table.degrees == 117
    assert table["e"].drop == pytest.approx(before - after)
    np.testing.assert_allclose(table["e"].estimate, solution[3:])
    assert table["e"].shift.shape == (3,)


def test_modulated_directions_have_the_size_of_the_field_part_by_part() -> None:
    generator = np.random.default_rng(16)
    frame, part = np.repeat(np.arange(50), 6), np.tile([0, 0, 0, 1, 1, 1], 50)
    delta = generator.normal(size=300)
    directions = modulated_directions(delta, part, frame, count=5)
    assert directions.shape == (300, 10)
    covariance = directions @ directions.T
    assert not covariance[np.ix_(part == 0, part == 1)].any()
    amplitude = np.diag(covariance) / delta**2
    assert amplitude[part == 0].mean() == pytest.approx(1.0)


def test_large_problem_takes_less_than_a_second() -> None:
    generator = np.random.default_rng(17)
    jacobian = generator.standard_normal((80_000, 10), dtype=np.float32)
    tangents = generator.standard_normal((20, 80_000, 3), dtype=np.float32)
    candidates = [candidate(f"e{k}", tangent) for k, tangent in enumerate(tangents)]
    residual = generator.standard_normal(80_000)
    seconds = []
    for _ in range(2):
        start = time.process_time()
        score_candidates(residual, jacobian, candidates, generator=generator)
        seconds.append(time.process_time() - start)
    assert min(seconds) < 1.0


def test_bad_input_is_named() -> None:
    generator = np.random.default_rng(18)
    jacobian, tangent = toy(generator)
    residual = np.zeros(120)
    with pytest.raises(ValueError, match="short: tangent of 119 rows, expected 120"):
        score_candidates(residual, jacobian, [candidate("short", tangent[1:])], generator=generator)
    with pytest.raises(ValueError, match="listed twice"):
        score_candidates(residual, jacobian, [candidate("a", tangent)] * 2, generator=generator)
    with pytest.raises(ValueError, match="Jacobian column 1"):
        score_candidates(residual, np.where([0, 1, 0], np.nan, jacobian), [], generator=generator)
    with pytest.raises(ValueError, match="finite tangent"):
        candidate("bad", np.full(120, np.inf))
