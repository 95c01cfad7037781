"""Effects not told apart, and the smallest that would have been seen."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from diagnose_toy import COUNT, candidate, smooth_tangents, table_of, toy
from mphygs.compare.residual_projection import project_out
from mphygs.diagnose.power import (
    detectable_along,
    detectable_length,
    detectable_strength,
    least_visible_direction,
)
from mphygs.diagnose.ties import compare_pair, separating_motions, tied_with


def test_tie_is_the_formula_for_single_parameters() -> None:
    generator = np.random.default_rng(7)
    jacobian, _ = toy(generator)
    first, second = smooth_tangents(generator, 2).reshape(COUNT, 2).T
    second = first + 0.5 * second
    residual = generator.standard_normal(COUNT) + 0.4 * first
    table = table_of(residual, jacobian, [candidate("e", first), candidate("f", second)])
    projection = project_out(jacobian)
    one, two = projection.remaining(first), projection.remaining(second)
    correlation = one @ two / np.sqrt((one @ one) * (two @ two))
    tie = compare_pair(table, "e", "f")
    assert tie.correlation == pytest.approx(abs(correlation))
    assert tie.expected == pytest.approx(table["e"].statistic * (1.0 - correlation**2))
    # Observed: the score of e once f has been projected out as well.
    after = table_of(residual, np.column_stack([jacobian, second]), [candidate("e", first)])
    assert tie.observed == pytest.approx(after["e"].statistic)


def test_collinear_effects_are_tied_and_independent_ones_are_not() -> None:
    generator = np.random.default_rng(8)
    jacobian, _ = toy(generator)
    base, other, third = smooth_tangents(generator, 3).reshape(COUNT, 3).T
    candidates = [
        candidate("truth", base),
        candidate("twin", 3.0 * base + 0.05 * other),
        candidate("other", other),
        candidate("wrong way", -base - 0.05 * third, bounded=True),
        candidate("pair", np.column_stack([base + 0.05 * other, third])),
    ]
    residual = generator.standard_normal(COUNT) + 0.5 * base
    table = table_of(residual, jacobian, candidates)
    assert {tie.rival for tie in tied_with(table, "truth")} == {"twin", "pair"}
    assert compare_pair(table, "truth", "wrong way").correlation > 0.99
    assert compare_pair(table, "pair", "truth").expected < 9.0


def test_the_separating_motion_is_the_one_where_the_tangents_differ() -> None:
    generator = np.random.default_rng(9)
    jacobian, _ = toy(generator)
    base, other = smooth_tangents(generator, 2).reshape(COUNT, 2).T
    silent = np.zeros(COUNT)
    tables = {
        "alike": table_of(silent, jacobian, [candidate("e", base), candidate("f", base + 0.01 * other)]),
        "apart": table_of(silent, jacobian, [candidate("e", base), candidate("f", other)]),
    }
    ranked = separating_motions(tables, "e", "f", increment=np.array([0.5]))
    assert [name for name, _ in ranked] == ["apart", "alike"]
    left = project_out(np.column_stack([jacobian, other])).remaining(base)
    assert ranked[0][1] == pytest.approx(0.25 * left @ left)


@pytest.mark.parametrize(("columns", "bounded"), [(1, True), (1, False), (3, False), (3, True)])
def test_power_at_the_smallest_detectable_strength(columns: int, bounded: bool) -> None:
    generator = np.random.default_rng(10)
    jacobian, _ = toy(generator)
    effect = candidate("e", smooth_tangents(generator, columns).reshape(COUNT, -1), bounded=bounded)
    score = table_of(np.zeros(COUNT), jacobian, [effect])["e"]
    strength = detectable_strength(score, level=0.05, family=10)
    if columns == 1 and bounded:
        formula = (norm.isf(0.005) + norm.ppf(0.8)) / np.sqrt(score.information[0, 0])
        assert strength[0] == pytest.approx(formula)
    found = [
        table_of(generator.standard_normal(COUNT) + effect.tangent[:, 0] * strength[0], jacobian, [effect])
        for _ in range(400)
    ]
    share = np.mean([table["e"].p_value < 0.005 for table in found])
    assert 0.75 < share < (0.85 if columns == 1 else 0.9)


def test_detectable_strength_by_direction_and_of_what_cannot_be_seen() -> None:
    generator = np.random.default_rng(11)
    jacobian, _ = toy(generator)
    tangent = smooth_tangents(generator, 2).reshape(COUNT, -1) * [1.0, 0.1]
    score = table_of(np.zeros(COUNT), jacobian, [candidate("e", tangent)])["e"]
    worst = least_visible_direction(score)
    strengths = detectable_strength(score, level=0.05, family=5)
    assert detectable_along(score, worst, level=0.05, family=5) >= strengths.max() * (1.0 - 1e-9)
    assert detectable_along(score, np.array([2.0, 0.0]), level=0.05, family=5) == pytest.approx(strengths[0])
    absorbed = table_of(np.zeros(COUNT), jacobian, [candidate("e", jacobian[:, :1])])["e"]
    assert np.isinf(detectable_strength(absorbed, level=0.05, family=5)).all()
    with pytest.raises(ValueError, match="not testable"):
        detectable_length(absorbed, level=0.05, family=5)
