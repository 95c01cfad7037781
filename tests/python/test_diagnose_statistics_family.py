"""Many candidates at once: Holm, the bootstrap of the strongest, decoys."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from diagnose_toy import COUNT, candidate, smooth_tangents, table_of, toy
from mphygs.compare.holm import holm
from mphygs.diagnose.decoys import check_decoys, decoy_tangents
from mphygs.diagnose.multiplicity import simulate_family


def test_holm_gives_the_textbook_adjustment() -> None:
    adjusted = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005})
    assert adjusted == pytest.approx({"a": 0.03, "b": 0.06, "c": 0.06, "d": 0.02})
    assert list(adjusted) == ["a", "b", "c", "d"]
    with pytest.raises(ValueError, match="a: p-value"):
        holm({"a": np.nan})


def test_holm_keeps_the_familywise_error_and_beats_bonferroni() -> None:
    generator = np.random.default_rng(1)
    draws = generator.random((2000, 8))
    wrong = np.mean([min(holm(dict(enumerate(row))).values()) < 0.05 for row in draws[:, :8]])
    assert wrong == pytest.approx(0.05, abs=0.016)
    assert holm({"a": 0.001, "b": 0.02})["b"] == pytest.approx(0.02)


@pytest.mark.parametrize("sigma_known", [True, False])
def test_family_p_value_is_uniform_for_the_leader_under_the_null(sigma_known: bool) -> None:
    generator = np.random.default_rng(2)
    jacobian, candidates = toy(generator)
    scale = 1.0 if sigma_known else 2.5
    law = None
    leaders, drops = [], []
    for _ in range(200):
        residual = scale * generator.standard_normal(COUNT)
        table = table_of(residual, jacobian, candidates, sigma_known=sigma_known)
        if law is None:
            law = simulate_family(table, generator=generator)
        leaders.append(min(law.p_value(score) for score in table.scores))
        drops.append(law.p_value_of_drop(max(score.drop for score in table.scores) / scale**2))
    assert kstest(leaders, "uniform").pvalue > 0.01
    assert kstest(drops, "uniform").pvalue > 0.01


def test_family_p_value_of_a_strong_effect_follows_the_union_bound() -> None:
    generator = np.random.default_rng(3)
    jacobian, candidates = toy(generator)
    residual = generator.standard_normal(COUNT) + candidates[1].tangent[:, 0] * 0.5
    table = table_of(residual, jacobian, candidates)
    law = simulate_family(table, generator=generator, draws=500)
    assert table["e1"].drop > 64.0
    assert law.p_value(table["e1"]) == pytest.approx(7 * table["e1"].p_value)


def test_family_needs_something_testable() -> None:
    dead = table_of(np.ones(COUNT), np.zeros((COUNT, 0)), [candidate("dead", np.zeros(COUNT))])
    with pytest.raises(ValueError, match="at least one testable"):
        simulate_family(dead, generator=np.random.default_rng(0))
    with pytest.raises(ValueError, match="do not absorb"):
        check_decoys(dead, generator=np.random.default_rng(0))


def test_decoys_are_as_smooth_as_the_candidates_and_not_among_them() -> None:
    generator = np.random.default_rng(4)
    tangents = smooth_tangents(generator, 8) * np.logspace(-5, 5, 8)
    decoys = decoy_tangents(tangents, 30, generator=generator)

    def roughness(series: np.ndarray) -> np.ndarray:
        return (np.diff(series, axis=0) ** 2).sum((0, 1, 2)) / (series**2).sum((0, 1, 2))

    assert np.median(roughness(decoys)) == pytest.approx(np.median(roughness(tangents)), rel=0.6)
    white = generator.normal(size=decoys.shape)
    assert roughness(decoys).max() < 0.2 * roughness(white).min()
    unit = tangents.reshape(COUNT, -1) / np.linalg.norm(tangents.reshape(COUNT, -1), axis=0)
    assert np.abs(unit.T @ decoys.reshape(COUNT, -1)).max() < 0.95
    with pytest.raises(ValueError, match="at least one tangent"):
        decoy_tangents(np.zeros_like(tangents), 3, generator=generator)


def test_decoys_hold_their_level_on_noise_and_give_understated_noise_away() -> None:
    generator = np.random.default_rng(5)
    tangents = smooth_tangents(generator, 8)
    decoys = decoy_tangents(tangents, 30, generator=generator).reshape(COUNT, -1)
    candidates = [candidate(f"decoy {k}", decoys[:, k]) for k in range(30)]
    jacobian = smooth_tangents(generator, 3).reshape(COUNT, -1)
    shares, p_values, inflated = [], [], []
    for _ in range(60):
        noise = generator.standard_normal(COUNT)
        good = check_decoys(table_of(noise, jacobian, candidates), generator=generator, draws=300)
        bad = check_decoys(table_of(2.5 * noise, jacobian, candidates), generator=generator, draws=300)
        shares.append(good.false_alarm_share)
        p_values.append(good.p_value)
        inflated.append(bad.p_value < 0.05)
    assert np.mean(shares) == pytest.approx(0.05, abs=0.03)
    assert np.mean(np.array(p_values) < 0.05) < 0.15
    assert np.mean(inflated) > 0.8
    assert bad.inflation == pytest.approx(6.25 * good.inflation)


def test_a_real_effect_stands_out_from_decoys() -> None:
    generator = np.random.default_rng(6)
    jacobian, candidates = toy(generator)
    decoys = decoy_tangents(smooth_tangents(generator, 8), 40, generator=generator).reshape(COUNT, -1)
    residual = generator.standard_normal(COUNT) + candidates[1].tangent[:, 0]
    table = table_of(
        residual, jacobian, [candidates[1], *(candidate(str(k), decoys[:, k]) for k in range(40))]
    )
    decoy_table = table_of(residual, jacobian, [candidate(str(k), decoys[:, k]) for k in range(40)])
    check = check_decoys(decoy_table, generator=generator)
    assert check.stands_out(table["e1"]) == pytest.approx(1 / 41)
    assert check.stands_out(table["0"]) > 1 / 41
