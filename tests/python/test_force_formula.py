"""Stepwise regression with stability under resampling, on columns made up."""

import numpy as np
import pytest

from mphygs.diagnose.force_formula import Regression, find_formula

ROWS, BLOCKS = 4000, 20
NAMES = ("v", "|v| v", "|v|^2 v", "e_x", "e_y", "twin")
SIMPLE = (True, False, True, True, True, True)


def columns(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Six features, the last a copy of the second but for a trace, two parameters, and the blocks."""
    random = np.random.default_rng(seed)
    features = random.standard_normal((ROWS, 6))
    features[:, 2] += 0.8 * features[:, 1]
    features[:, 5] = features[:, 1] + 0.02 * features[:, 5]
    parameters = random.standard_normal((ROWS, 2))
    return features, parameters, np.repeat(np.arange(BLOCKS), ROWS // BLOCKS)


def formula(data: np.ndarray, features: np.ndarray, parameters: np.ndarray, block: np.ndarray):
    regression = Regression.of(data, features, parameters, block)
    return find_formula(regression, NAMES, ["1"] * 6, SIMPLE, generator=np.random.default_rng(3))


def test_terms_are_found_beside_parameters_that_hide_them() -> None:
    features, parameters, block = columns()
    noise = np.random.default_rng(1).standard_normal(ROWS)
    features[:, 3] += 3.0 * parameters[:, 0]
    data = -2.0 * features[:, 2] + 0.7 * features[:, 3] + parameters @ [30.0, -20.0] + noise
    found = formula(data, features, parameters, block)
    assert [t.expression for t in found.terms] == ["|v|^2 v", "e_x"]
    assert found.terms[0].coefficient == pytest.approx(-2.0, abs=4 * found.terms[0].std)
    assert found.terms[1].coefficient == pytest.approx(0.7, abs=4 * found.terms[1].std)
    assert 0.01 < found.terms[0].std < 0.05
    assert found.text.startswith("-2") and " + 0.7" in found.text
    assert found.explained == pytest.approx(1.0, abs=0.05)


def test_noise_alone_has_no_formula() -> None:
    features, parameters, block = columns()
    data = np.random.default_rng(2).standard_normal(ROWS) + parameters @ [5.0, 5.0]
    found = formula(data, features, parameters, block)
    assert found.terms == () and found.text == "no stable formula"


def test_a_term_of_one_block_is_not_stable() -> None:
    features, parameters, block = columns()
    data = np.random.default_rng(4).standard_normal(ROWS)
    once = block == 7
    data[once] += 4.0 * features[once, 4]
    found = formula(data, features, parameters, block)
    assert found.terms == ()
    assert found.unstable[0][0] == "e_y" and 0.2 < found.unstable[0][1] < 0.7


def test_features_all_but_parallel_are_one_term() -> None:
    features, parameters, block = columns()
    data = 3.0 * features[:, 1] + np.random.default_rng(5).standard_normal(ROWS)
    (term,) = formula(data, features, parameters, block).terms
    assert (term.expression, term.alike) == ("twin", ("|v| v",)), "the simple one speaks for both"
    assert term.stability > 0.95


def test_a_formula_that_explains_less_than_half_is_not_told() -> None:
    features, parameters, block = columns()
    rest = np.random.default_rng(6).standard_normal((ROWS, 60))
    data = 0.4 * features[:, 3] + np.random.default_rng(7).standard_normal(ROWS)
    assert [t.expression for t in formula(data, features, parameters, block).terms] == ["e_x"]
    found = formula(data + rest @ np.full(60, 0.09), features, parameters, block)
    assert found.terms == () and found.explained == 0.0
    assert found.unstable[0][0] == "e_x" and found.unstable[0][1] > 0.9
    assert found.untold.startswith("e_x would explain 2") and found.untold.endswith("% of the misfit")


def test_a_term_of_an_unsure_coefficient_is_not_told() -> None:
    features, parameters, block = columns()
    # Its sign is another in every block, but for a mean that stands out of 20 of them by two errors or so.
    change = np.random.default_rng(8).standard_normal(BLOCKS)
    strength = 0.9 + 1.9 * (change - change.mean()) / change.std()
    data = 2.5 * features[:, 0] + strength[block] * features[:, 4]
    data += np.random.default_rng(9).standard_normal(ROWS)
    found = formula(data, features, parameters, block)
    assert [t.expression for t in found.terms] == ["v"], "the sure term stays"
    assert dict(found.unstable)["e_y"] > 0.7, "chosen again and again, and not sure"
