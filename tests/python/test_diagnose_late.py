"""Steady loads that came after the published shape was taken."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, entry_of, recorded
from mphygs.diagnose import rank as ranking
from mphygs.diagnose.effect_variants import LATE_PLACES, SINCE_THE_START, late_variants, smooth_variants
from mphygs.diagnose.rank import rank
from mphygs.diagnose.ranking import RankedEffect
from mphygs.diagnose.refit_starts import refit_start
from mphygs.extend.separating_motions import _variant_of
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor, Settings
from variants_example import between, mass_way, wind_way

FREE = ("part0.youngs_modulus",)
FRAMES = 24
CAME = {"at_rest": False}


@cache
def resting(prestress: str = "equilibrium") -> tuple[Predictor, Belief]:
    """A shaken bar whose published shape bears its weight."""
    shake = 0.002 * np.sin(np.linspace(0.0, 9.0, FRAMES))[:, None] * [0.0, 1.0, 0.3]
    rest = "equilibrium" if prestress == "equilibrium" else "stress-free"
    capture = bar_capture(frames=FRAMES, fps=60.0, rest=rest, motion=shake, fit=(0, FRAMES))
    belief = bar_belief(capture, youngs_modulus=8e4, prestress=prestress, free=FREE)
    return Predictor(capture, capture.sequence("a"), Settings(SPACING, workers=1)), belief


def ranked(truth: Belief, *, names: tuple[str, ...] | None = None) -> tuple[RankedEffect, ...]:
    """How effects rank for the elastic model fitted to a motion."""
    predictor, belief = resting()
    capture = recorded(predictor.capture, truth)
    experiment = Experiment.of(capture, Settings(SPACING, workers=1))
    fitted: Solution = minimise(experiment.problem(SPACING), belief)
    return rank(
        experiment, fitted.belief, fitted.evaluation, SPACING,
        generator=np.random.default_rng(0), names=names, trials=False,
    ).entries  # fmt: skip


def test_what_acts_since_the_first_frame_is_a_candidate_where_the_shape_bears_a_load() -> None:
    predictor, belief = resting()
    ways, blocks = late_variants(belief, predictor.body), predictor.body.free_block_count
    assert Counter(way.effect for way in ways) == {
        "gravity": 1, "wind": 6, "attached_mass": min(LATE_PLACES, blocks), "tether": 3,
    }  # fmt: skip
    for way in ways:
        assert way.label.endswith(SINCE_THE_START)
        for extended, _parameter in way.columns:
            assert extended.term(way.effect).settings["at_rest"] is False
        start = refit_start(way, np.full(len(way.columns), 0.01), belief)
        assert start.term(way.effect).settings["at_rest"] is False
    # Beside those that the shape bears, with labels of their own; the model's own effects are none.
    labels = [way.label for way in (*smooth_variants(belief, predictor.body), *ways)]
    assert len(set(labels)) == len(labels)
    windy = belief.with_effect("wind", {"c_d": 1.0, "w_x": 1.0})
    assert {way.effect for way in late_variants(windy, predictor.body)} == {
        "gravity",
        "attached_mass",
        "tether",
    }
    asked = late_variants(belief, predictor.body, names=("tether", "viscosity"))
    assert {way.effect for way in asked} == {"tether"}
    # A shape that is free of stress bears nothing.
    free, free_belief = resting("off")
    assert late_variants(free_belief, free.body) == []


@pytest.mark.parametrize("name", ["gravity", "wind", "attached_mass", "tether"])
def test_tangents_of_a_late_load_follow_differences(name: str) -> None:
    """Beside the same load borne by the shape, which moves nothing at first."""
    predictor, belief = resting()
    way = next(w for w in late_variants(belief, predictor.body, names=(name,)))
    extended, parameter = way.columns[-1]
    tangent = predictor.predict(belief, candidates=[(extended, parameter)]).jacobian[..., 0] / parameter.slope
    step = {"gravity": 0.05, "wind": 0.4, "attached_mass": 2e-5, "tether": 0.02}[name]
    moved = predictor.predict(extended.with_parameter(parameter.key, value=parameter.value + step)).position
    change = moved - predictor.predict(belief).position
    assert np.abs(change).max() > 1e-5
    np.testing.assert_allclose(tangent * step, change, atol=0.05 * np.abs(change).max())
    # The same load, borne by the shape.
    term = extended.term(name)
    settings = {key: value for key, value in term.settings.items() if key != "at_rest"}
    terms = tuple(replace(t, settings=settings) if t is term else t for t in extended.terms)
    borne = replace(extended, terms=terms).with_parameter(parameter.key, value=parameter.value + step)
    other = predictor.predict(borne).position - predictor.predict(belief).position
    early = slice(1, 5)
    assert np.abs(change[early]).max() > 2.0 * np.abs(other[early]).max()


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("gravity", {"delta_g_y": 0.4}),
        ("attached_mass", {"m": 1e-3}),
    ],
)
def test_a_load_that_came_after_the_scan_is_named_with_that(name: str, values: dict[str, float]) -> None:
    _, belief = resting()
    place = {"place": [0.055, 0.01, 0.01]} if name == "attached_mass" else {}
    truth = belief.with_effect(name, values, place | CAME)
    entries = ranked(truth)
    found = next(entry for entry in entries if entry.effect == name)
    # A far tether pulls as a mass weighs, and so does a tilt on a bar that hardly swings.
    assert found.statistic > 0.9 * entries[0].statistic
    assert found.label.endswith(SINCE_THE_START)
    assert found.start.term(name).settings["at_rest"] is False
    assert found.expected_ratio < 1.5
    for key, value in values.items():
        assert found.estimate[key] == pytest.approx(value, rel=0.3)
    # A mass is begun from the next best places too, each once.
    starts = [np.array(start.term(name).settings.get("place", 0.0)) for start in (found.start, *found.others)]
    assert len(starts) == (1 + ranking.ELSEWHERE if place else 1)
    assert all(start.term(name).settings["at_rest"] is False for start in found.others)
    if place:
        apart = np.linalg.norm(np.array(starts)[:, None] - np.array(starts), axis=-1)
        assert np.all(apart[~np.eye(len(starts), dtype=bool)] > 1e-4)


def test_late_loads_are_not_tried_where_the_first_frames_are_right(monkeypatch: pytest.MonkeyPatch) -> None:
    _, belief = resting()
    monkeypatch.setattr(ranking, "late_variants", lambda *_, **__: pytest.fail("late loads were asked for"))
    # Damping shows when something moves, a tilt that the shape bears hardly ever.
    entries = ranked(belief.with_effect("mass_damping", {"alpha": 6.0}), names=("mass_damping", "gravity"))
    assert entries[0].effect == "mass_damping" and entries[0].statistic > 100.0


@pytest.mark.parametrize("late", [False, True])
def test_a_wind_between_the_axes_is_scored_as_well(late: bool) -> None:
    predictor, belief = resting()
    axes = [sign * axis for axis in np.eye(3) for sign in (1.0, -1.0)]
    ways = [wind_way(belief, axis, late=late) for axis in axes]
    columns = [pair for way in ways for pair in way.columns]
    tangents = predictor.predict(belief, candidates=columns).jacobian.reshape(-1, len(columns))
    none = np.zeros((len(tangents), 0))
    # Drags of 3 and 4 along +y and -z are one of 5 between them.
    residual = tangents @ np.array([0.0, 0.0, 3.0, 0.0, 0.0, 4.0])
    found = between(belief, predictor.body, ways, tangents, residual, none, late=late)
    assert found is not None and found.effect == "wind"
    assert found.settings == (CAME if late else {})
    flow = np.array([found.values[f"w_{a}"] for a in "xyz"])
    np.testing.assert_allclose(flow, [0.0, 1.2, -1.6], atol=1e-3)
    assert "0.60, -0.80" in found.label
    # One axis alone needs no other, nor do flows of the other kind count.
    assert between(belief, predictor.body, ways, tangents, tangents[:, 3], none, late=late) is None
    assert between(belief, predictor.body, ways, tangents, residual, none, late=not late) is None
    # Where ways were fitted that differ, opposite flows may do best together: what is left of them was tried.
    apart = np.random.default_rng(2).standard_normal((60, 6))
    none = np.zeros((60, 0))
    opposite = apart @ np.array([3.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    assert between(belief, predictor.body, ways, apart, opposite, none, late=late) is None
    assert between(belief, predictor.body, ways, apart, opposite + apart[:, 2], none, late=late) is not None


def test_a_mass_between_is_late_as_those_around_it() -> None:
    predictor, belief = resting()
    places = np.array([[0.055, 0.004, 0.01], [0.055, 0.016, 0.01]])
    ways = [mass_way(belief, place, late=late) for late in (False, True) for place in places]
    columns = [pair for way in ways for pair in way.columns]
    tangents = predictor.predict(belief, candidates=columns).jacobian.reshape(-1, len(columns))
    none = np.zeros((len(tangents), 0))
    for late, masses in ((False, [1.0, 1.0, 0.0, 0.0]), (True, [0.0, 0.0, 1.0, 1.0])):
        found = between(belief, predictor.body, ways, tangents, tangents @ masses, none, late=late)
        assert found is not None and found.settings.get("at_rest", True) is not late
        assert np.linalg.norm(np.array(found.settings["place"]) - [0.055, 0.01, 0.01]) < 0.006


def test_the_next_motion_is_asked_of_the_way_that_was_found() -> None:
    predictor, belief = resting()
    ways = [*smooth_variants(belief, predictor.body), *late_variants(belief, predictor.body)]
    for late in (False, True):
        # A mass between the places that are tried has a label of its own.
        settings = {"place": [0.05, 0.01, 0.01]} | (CAME if late else {})
        start = belief.with_effect("attached_mass", {"m": 1e-3}, settings)
        entry = replace(entry_of("attached_mass", 100.0), label="attached_mass in between", start=start)
        found = _variant_of(entry, ways)
        assert found is not None and found.effect == "attached_mass"
        assert found.label.endswith(SINCE_THE_START) is late
        own = [way for way in ways if way.effect == "attached_mass"]
        exact = [way for way in own if (SINCE_THE_START in way.label) is late][-1]
        assert _variant_of(replace(entry, label=exact.label), ways) is exact
    assert _variant_of(None, ways) is None
