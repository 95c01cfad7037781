"""Where a refit of a tether starts: its springs' estimate, which may come out with no stiffness at all."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from mphygs.diagnose.effect_variants import EffectVariant, late_variants, smooth_variants
from mphygs.diagnose.refit_starts import other_starts, refit_start
from mphygs.model.belief import Belief
from test_diagnose_late import resting


def tether() -> tuple[EffectVariant, Belief]:
    predictor, belief = resting()
    return smooth_variants(belief, predictor.body, names=["tether"])[0], belief


def pull(start: Belief) -> np.ndarray:
    """(3,) [N] on the object where it was published."""
    place = np.array(start.term("tether").settings["place"])
    anchor = np.array([start[f"tether.anchor_{a}"].value for a in "xyz"])
    return start["tether.k"].value * (anchor - place)


def score_of(estimate: list[float], std: float) -> SimpleNamespace:
    return SimpleNamespace(estimate=np.array(estimate), information=np.eye(4) / std**2)


@pytest.mark.parametrize(
    ("estimate", "stiffness"),
    [
        ([1.0, 0.3, 0.0, -0.4], 0.9),
        # none came out: the anchor of the pull is as far away as the object is large
        ([-9.0, 0.3, 0.0, -0.4], 0.5),
        ([0.0, 0.0, 0.0, 0.0], 1e-3),
    ],
)
def test_a_tether_pulls_as_its_springs_do(estimate: list[float], stiffness: float) -> None:
    way, belief = tether()
    start = refit_start(way, np.array(estimate), belief)
    assert start["tether.k"].value == pytest.approx(stiffness)
    np.testing.assert_allclose(pull(start), way.scale * np.array(estimate[1:]), atol=1e-12)
    assert {p.key for p in start.free if p.key.startswith("tether.")} == {
        "tether.k", "tether.anchor_x", "tether.anchor_y", "tether.anchor_z",
    }  # fmt: skip
    assert set(start.term("tether").settings) == {"place"}


@pytest.mark.parametrize(
    ("estimate", "std", "stiffnesses"),
    [
        # 0.9 +- 0.2, and +- 1
        ([1.0, 0.3, 0.0, -0.4], 0.1, []),
        ([1.0, 0.3, 0.0, -0.4], 0.5, [0.5, 1.5]),
        # where none came out the first of them is the start itself
        ([-9.0, 0.3, 0.0, -0.4], 0.5, [1.5]),
        ([-9.0, 0.3, 0.0, -0.4], 1e-3, [1.5]),
    ],
)
def test_a_stiffness_that_the_estimate_does_not_tell_is_tried_from_nearer_by(
    estimate: list[float], std: float, stiffnesses: list[float]
) -> None:
    way, belief = tether()
    starts = other_starts(way, score_of(estimate, std), belief)
    assert [start["tether.k"].value for start in starts] == pytest.approx(stiffnesses)
    for start in starts:
        np.testing.assert_allclose(pull(start), way.scale * np.array(estimate[1:]), atol=1e-12)


def test_a_tether_that_came_late_starts_late() -> None:
    predictor, belief = resting()
    way = late_variants(belief, predictor.body, names=["tether"])[0]
    starts = other_starts(way, score_of([-9.0, 0.3, 0.0, -0.4], 0.5), belief)
    assert [start.term("tether").settings["at_rest"] for start in starts] == [False]
