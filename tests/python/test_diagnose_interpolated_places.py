"""A point mass between the places that were tried."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.diagnose.effect_variants import EffectVariant, place_digits, smooth_variants
from mphygs.simulate.prediction import Predictor, Settings
from variants_example import between, mass_way

PLACES = np.array([[0.055, 0.004, 0.01], [0.055, 0.016, 0.01], [0.02, 0.01, 0.01]])


def scene() -> tuple[Predictor, object]:
    capture = bar_capture(frames=12, fps=60.0)
    belief = bar_belief(capture, free=("part0.youngs_modulus",))
    return Predictor(capture, capture.sequence("a"), Settings(0.01, workers=1)), belief


def tangents_of(predictor: Predictor, belief: object, ways: list[EffectVariant]) -> np.ndarray:
    columns = [pair for way in ways for pair in way.columns]
    jacobian = predictor.predict(belief, candidates=columns).jacobian
    return jacobian.reshape(-1, len(columns))


def found(residual_of: np.ndarray, *, absorb: bool = False) -> EffectVariant | None:
    predictor, belief = scene()
    ways = [mass_way(belief, place) for place in PLACES]
    tangents = tangents_of(predictor, belief, ways)
    own = predictor.predict(belief, keys=["part0.youngs_modulus"]).jacobian.reshape(len(tangents), -1)
    residual = tangents @ residual_of + (own[:, 0] if absorb else 0.0)
    return between(belief, predictor.body, ways, tangents, residual, own)


def test_two_corners_stand_for_what_hangs_between_them() -> None:
    way = found(np.array([1.0, 1.0, 0.0]))
    assert way is not None and way.effect == "attached_mass"
    # To the nearest material point of cells of 1 cm.
    assert np.linalg.norm(np.array(way.settings["place"]) - [0.055, 0.01, 0.01]) < 0.006


def test_the_heavier_side_draws_the_centre() -> None:
    left, right = (np.array(found(np.array(m)).settings["place"]) for m in ([3.0, 1.0, 0.0], [1.0, 3.0, 0.0]))
    assert left[1] < right[1]


def test_one_place_that_does_it_alone_is_kept() -> None:
    assert found(np.array([0.0, 1.0, 0.0])) is None


def test_what_the_materials_absorb_moves_no_mass() -> None:
    plain, absorbed = found(np.array([1.0, 1.0, 0.0])), found(np.array([1.0, 1.0, 0.0]), absorb=True)
    np.testing.assert_allclose(absorbed.settings["place"], plain.settings["place"], atol=1e-4)


def test_a_mass_on_the_axis_is_found_though_all_places_are_corners() -> None:
    predictor, belief = scene()
    ways = [w for w in smooth_variants(belief, predictor.body, names=("attached_mass",))]
    corners = np.array([w.settings["place"] for w in ways])
    assert np.all(np.abs(corners[:, 1:] - 0.01) > 0.004)
    truth = mass_way(belief, np.array([0.057, 0.01, 0.01]))
    column = tangents_of(predictor, belief, [truth])[:, 0]
    tangents = tangents_of(predictor, belief, ways)
    own = predictor.predict(belief, keys=["part0.youngs_modulus"]).jacobian.reshape(len(tangents), -1)
    way = between(belief, predictor.body, ways, tangents, column, own)
    place = np.array(way.settings["place"])
    assert np.all(np.abs(place[1:] - 0.01) < 0.002) and place[0] > 0.045


def test_a_centre_that_rounds_to_a_place_has_a_label_of_its_own() -> None:
    predictor, belief = scene()
    places = np.array([[0.0504, 0.0044, 0.0104], [0.0496, 0.0096, 0.0096], [0.0504, 0.0164, 0.0104]])
    ways = [mass_way(belief, place) for place in places]
    assert ways[1].label == "attached_mass at (0.050, 0.010, 0.010)"
    tangents = tangents_of(predictor, belief, ways)
    none = np.zeros((len(tangents), 0))
    way = between(belief, predictor.body, ways, tangents, tangents @ np.array([1.0, 0.0, 1.0]), none)
    assert way.label == "attached_mass at (0.0504, 0.0104, 0.0104)"


def test_a_centre_at_a_place_that_was_tried_is_no_new_one() -> None:
    predictor, belief = scene()
    ways = [mass_way(belief, np.array([0.05, y, 0.01])) for y in (0.004, 0.01, 0.016)]
    tangents = tangents_of(predictor, belief, ways)
    none = np.zeros((len(tangents), 0))
    sides = tangents @ np.array([1.0, 0.0, 1.0])
    assert between(belief, predictor.body, ways, tangents, sides, none) is None


def test_places_in_small_objects_are_told_apart() -> None:
    predictor, belief = scene()
    assert place_digits(predictor.body) == 3
    small = replace(predictor.body.quadrature, spacing=1e-3 * np.ones(3))
    assert place_digits(replace(predictor.body, quadrature=small)) == 4
    assert mass_way(belief, np.array([0.0551, -0.004, 0.01]), 4).label == (
        "attached_mass at (0.0551, -0.0040, 0.0100)"
    )


def test_without_places_there_is_nothing_between() -> None:
    predictor, belief = scene()
    one = [mass_way(belief, PLACES[0])]
    column = tangents_of(predictor, belief, one)
    assert between(belief, predictor.body, one, column, column[:, 0], np.zeros((len(column), 0))) is None
    assert between(belief, predictor.body, [], column[:, :0], column[:, 0], column[:, :0]) is None


def test_a_label_says_where() -> None:
    _, belief = scene()
    way = mass_way(belief, np.array([0.0551, -0.004, 0.01]))
    assert way.label == "attached_mass at (0.055, -0.004, 0.010)"
    assert way.settings["place"] == pytest.approx([0.0551, -0.004, 0.01])
