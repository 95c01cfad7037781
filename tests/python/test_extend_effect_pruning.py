"""Effects that a later one made superfluous."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, excess_of, recorded
from mphygs.extend import effect_pruning
from mphygs.extend.conclusion import conclude
from mphygs.extend.effect_pruning import with_effects_pruned
from mphygs.extend.step import Step
from mphygs.extend.steps import step_at, step_document
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Settings

ETA, TILT = 20.0, 1.5


@cache
def scene(tilt: float) -> tuple[Experiment, Belief]:
    """A viscous bar, gravity tilted by so much [m/s^2], and its elastic model."""
    capture = bar_capture(frames=30, fps=100.0, fit=(0, 30))
    elastic = bar_belief(capture, youngs_modulus=6e4, free=("part0.youngs_modulus",))
    truth = elastic.with_effect("viscosity", {"eta": ETA})
    if tilt:
        truth = truth.with_effect("gravity", {"delta_g_y": tilt})
    return Experiment.of(recorded(capture, truth), Settings(SPACING, workers=1)), elastic


def both(tilt: float) -> tuple[Experiment, Step, Step]:
    """The steps with gravity and then viscosity, at the truth."""
    experiment, elastic = scene(tilt)
    tilted = elastic.with_effect("gravity", {"delta_g_y": tilt})
    full = tilted.with_effect("viscosity", {"eta": ETA})
    before = step_at(experiment, tilted, SPACING, added=("gravity",))
    return experiment, before, step_at(experiment, full, SPACING, added=("viscosity",))


def test_what_is_superfluous_goes() -> None:
    experiment, before, last = both(0.0)
    said: list[str] = []
    found = with_effects_pruned(experiment, last, ["gravity"], said.append)
    assert found.belief.effects == ("viscosity",) and found.added == ("viscosity",)
    assert said[0].startswith("without gravity: ")
    concluded = conclude([step_at(experiment, scene(0.0)[1], SPACING), before, found], [], [])
    assert (concluded.verdict, concluded.effects) == ("missing", ("viscosity",))
    assert step_document(found, experiment, ("gravity", "marker_outliers"))["effects"] == [
        "marker_outliers",
        "viscosity",
    ]
    # What the user put into the first model is not the loop's to take away.
    assert with_effects_pruned(experiment, last, []) is last


def test_what_is_needed_stays() -> None:
    experiment, _, last = both(TILT)
    said: list[str] = []
    assert with_effects_pruned(experiment, last, ["gravity"], said.append) is last
    # It is far off after the first iterations: the rest of them, and the comparison, are saved.
    assert said[-1].endswith("given up")


def test_a_coarse_grid_leads_as_far_as_it_can(monkeypatch: pytest.MonkeyPatch) -> None:
    def jacobian_source(experiment: Experiment, spacing: float) -> Problem:
        assert spacing == SPACING
        return experiment.problem(1.5 * SPACING)

    monkeypatch.setattr(effect_pruning, "jacobian_source", jacobian_source)
    experiment, _, last = both(0.0)
    assert with_effects_pruned(experiment, last, ["gravity"]).belief.effects == ("viscosity",)

    def own(*_: object, **__: object) -> None:
        raise AssertionError("a Jacobian of its own")

    # What is needed is far off there already.
    monkeypatch.setattr(effect_pruning, "minimise", own)
    experiment, _, last = both(TILT)
    said: list[str] = []
    assert with_effects_pruned(experiment, last, ["gravity"], said.append) is last
    assert said[-1].endswith("given up")


def test_what_may_still_do_as_well_is_fitted_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effect_pruning, "FAR", 1e9)
    experiment, _, last = both(TILT)
    said: list[str] = []
    assert with_effects_pruned(experiment, last, ["gravity"], said.append) is last
    assert said[-1].endswith("in the worst range")


@pytest.mark.parametrize(("rise", "goes"), [(1.04, True), (1.07, False)])
def test_what_pays_a_little_of_a_large_misfit_stays(
    rise: float, goes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment, _, last = both(0.0)
    last = replace(last, assessment=excess_of(10.0))
    monkeypatch.setattr(effect_pruning, "_far", lambda *_: False)
    monkeypatch.setattr(experiment, "assess", lambda _compared: excess_of(rise * 10.0))
    assert (with_effects_pruned(experiment, last, ["gravity"]).belief.effects == ("viscosity",)) is goes
