"""A wind that may be none is the drag of still air, a relaxation without memory a viscosity."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, assessment_of, recorded
from mphygs.extend import nested_models
from mphygs.extend.conclusion import conclude
from mphygs.extend.nested_effects import SHORT, at_short_time_limit
from mphygs.extend.nested_models import with_simpler_effects
from mphygs.extend.step import Step
from mphygs.extend.steps import step_at
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Settings

DRAG = 60.0
CAPTURE = bar_capture(frames=30, fps=100.0, fit=(0, 30))
ELASTIC = bar_belief(CAPTURE, youngs_modulus=6e4, free=("part0.youngs_modulus",))


def fitted(model: Belief, truth: Belief) -> tuple[Experiment, Step]:
    """A bar recorded with what is true of it, and a model with one effect fitted to that."""
    experiment = Experiment.of(recorded(CAPTURE, truth), Settings(SPACING, workers=1))
    found = minimise(experiment.problem(SPACING), experiment.starting(model), iterations=12)
    return experiment, step_at(experiment, found.belief, SPACING, added=model.effects)


@cache
def scene(wind: float) -> tuple[Experiment, Step]:
    """A bar that air slows down, flowing along y [m/s], and the model with a wind, fitted."""
    flow = ELASTIC.with_effect("wind", {"w_y": wind, "w_x": 0.01, "w_z": 0.01, "c_d": DRAG})
    return fitted(flow, flow if wind else ELASTIC.with_effect("air_drag", {"c_d": DRAG}))


def test_still_air_is_named_and_the_wind_is_a_tie() -> None:
    experiment, step = scene(0.0)
    assert step.explained, "a wind explains what still air does"
    said: list[str] = []
    after = with_simpler_effects(experiment, step, said.append)
    assert (after.added, after.ties, after.dropped) == (("air_drag",), ("wind",), ("wind",))
    assert after.belief.effects == ("air_drag",) and after.explained and "air_drag" in said[-1]
    drag = after.belief["air_drag.c_d"]
    assert drag.free and drag.value == pytest.approx(DRAG, rel=0.05)
    assert conclude([step, after], [], []).effects == ("air_drag",)


def test_a_wind_that_blows_stays() -> None:
    experiment, step = scene(1.5)
    assert step.explained
    assert with_simpler_effects(experiment, step) is step


def test_a_wind_that_only_takes_up_what_the_grid_has_is_still_air(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, step = scene(0.0)
    monkeypatch.setattr(nested_models, "_untold", lambda *_: False)
    assert with_simpler_effects(experiment, step).added == ("air_drag",)
    # What blows and is not explained without is no tie either.
    monkeypatch.setattr(nested_models, "_with", lambda *_: None)
    assert with_simpler_effects(experiment, step) is step


def test_where_still_air_does_not_explain_it_is_a_tie(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, step = scene(0.0)
    monkeypatch.setattr(nested_models, "_with", lambda *_: None)
    after = with_simpler_effects(experiment, step)
    assert after.added == ("wind",) and after.ties == ("air_drag",)


def test_an_effect_of_an_earlier_step_is_exchanged_too() -> None:
    experiment, step = scene(0.0)
    after = with_simpler_effects(experiment, replace(step, added=("viscosity",), ties=("relaxation",)))
    assert after.added == ("viscosity", "air_drag") and after.ties == ("wind", "relaxation")
    assert after.dropped == ("wind",)


def test_nothing_is_asked_of_a_model_without_a_wind_or_that_explains_nothing() -> None:
    experiment, step = scene(0.0)
    off = {"s0": {"fit": 3.0}}
    lost = replace(step, assessment=replace(step.assessment, adequate=False, ratio=off))
    assert not lost.explained and np.isfinite(lost.assessment.worst)
    assert with_simpler_effects(experiment, lost) is lost
    still = with_simpler_effects(experiment, step)
    assert with_simpler_effects(experiment, still) is still


# ---- a relaxation that is over at once --------------------------------------------------------
VISCOSITY = 15.0


@cache
def damped(tau: float) -> tuple[Experiment, Step]:
    """A viscous bar, or one with a relaxation of this time [s], and the model with a relaxation, fitted."""
    relaxing = ELASTIC.with_effect("relaxation", {"ratio": 0.4, "tau": tau or 1e-3})
    return fitted(relaxing, relaxing if tau else ELASTIC.with_effect("viscosity", {"eta": VISCOSITY}))


def test_a_relaxation_without_memory_is_a_viscosity() -> None:
    experiment, step = damped(0.0)
    assert step.explained and step.belief["relaxation.tau"].value < SHORT / 100.0
    begun = at_short_time_limit(step.belief, "relaxation", 100.0)
    assert begun is not None and begun["viscosity.eta"].log
    # Q = ratio tau S': the same work on a motion that is slow beside tau.
    assert begun["viscosity.eta"].value == pytest.approx(VISCOSITY, rel=0.5)
    after = with_simpler_effects(experiment, step)
    assert (after.added, after.ties) == (("viscosity",), ("relaxation",))
    assert after.belief["viscosity.eta"].value == pytest.approx(VISCOSITY, rel=0.02)
    # Tied with it already: it was compared.
    assert with_simpler_effects(experiment, replace(step, ties=("viscosity",))).added == ("relaxation",)


def test_a_relaxation_with_memory_stays() -> None:
    experiment, step = damped(0.03)
    assert step.explained and step.belief["relaxation.tau"].value > SHORT / 100.0
    assert at_short_time_limit(step.belief, "relaxation", 100.0) is None
    assert with_simpler_effects(experiment, step) is step


@pytest.mark.parametrize(("left", "exchanged"), [(1.01, True), (1.09, False)])
def test_a_viscosity_that_explains_less_is_not_told_for_a_short_relaxation(
    left: float, exchanged: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both are explained: what the viscosity leaves beyond noise decides."""
    experiment, step = damped(0.0)
    viscous = at_short_time_limit(step.belief, "relaxation", 100.0)
    other = replace(step, added=("viscosity",), belief=viscous, assessment=assessment_of(left))
    assert other.explained
    monkeypatch.setattr(nested_models, "_with", lambda *_: other)
    step = replace(step, assessment=assessment_of(1.0))
    assert with_simpler_effects(experiment, step) is (other if exchanged else step)
