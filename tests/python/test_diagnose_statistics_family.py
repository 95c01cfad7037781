"""Many candidates at once: Holm, the bootstrap of the strongest, decoys."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import kstest

from diagnose_toy import COUNT, candidate, table_of, toy
from mphygs.compare.holm import holm
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
