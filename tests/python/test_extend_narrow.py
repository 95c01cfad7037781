"""A wind that may be none is the drag of still air."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, recorded
from mphygs.extend import narrow
from mphygs.extend.discover import _conclude
from mphygs.extend.narrow import narrowed
from mphygs.extend.step import Step
from mphygs.extend.steps import step_at
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.simulate.prediction import Settings

DRAG = 60.0


@cache
def scene(wind: float) -> tuple[Experiment, Step]:
    """A bar that air slows down, flowing along y [m/s], and the model with a wind, fitted."""
    capture = bar_capture(frames=30, fps=100.0, fit=(0, 30))
    elastic = bar_belief(capture, youngs_modulus=6e4, free=("part0.youngs_modulus",))
    flow = elastic.with_effect("wind", {"w_y": wind, "w_x": 0.01, "w_z": 0.01, "c_d": DRAG})
    truth = flow if wind else elastic.with_effect("air_drag", {"c_d": DRAG})
    experiment = Experiment.of(recorded(capture, truth), Settings(SPACING, workers=1))
    found = minimise(experiment.problem(SPACING), experiment.starting(flow), iterations=10)
    return experiment, step_at(experiment, found.belief, SPACING, added=("wind",))


def test_still_air_is_named_and_the_wind_is_a_tie() -> None:
    experiment, step = scene(0.0)
    assert step.explained, "a wind explains what still air does"
    said: list[str] = []
    after = narrowed(experiment, step, said.append)
    assert (after.added, after.ties, after.dropped) == (("air_drag",), ("wind",), ("wind",))
    assert after.belief.effects == ("air_drag",) and after.explained and "air_drag" in said[-1]
    drag = after.belief["air_drag.c_d"]
    assert drag.free and drag.value == pytest.approx(DRAG, rel=0.05)
    assert _conclude([step, after], [], []).effects == ("air_drag",)


def test_a_wind_that_blows_stays() -> None:
    experiment, step = scene(1.5)
    assert step.explained
    assert narrowed(experiment, step) is step


def test_a_wind_that_only_takes_up_what_the_grid_has_is_still_air(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, step = scene(0.0)
    monkeypatch.setattr(narrow, "_untold", lambda *_: False)
    assert narrowed(experiment, step).added == ("air_drag",)
    # What blows and is not explained without is no tie either.
    monkeypatch.setattr(narrow, "_with", lambda *_: None)
    assert narrowed(experiment, step) is step


def test_where_still_air_does_not_explain_it_is_a_tie(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, step = scene(0.0)
    monkeypatch.setattr(narrow, "_with", lambda *_: None)
    after = narrowed(experiment, step)
    assert after.added == ("wind",) and after.ties == ("air_drag",)


def test_an_effect_of_an_earlier_step_is_exchanged_too() -> None:
    experiment, step = scene(0.0)
    after = narrowed(experiment, replace(step, added=("viscosity",), ties=("relaxation",)))
    assert after.added == ("viscosity", "air_drag") and after.ties == ("wind", "relaxation")
    assert after.dropped == ("wind",)


def test_nothing_is_asked_of_a_model_without_a_wind_or_that_explains_nothing() -> None:
    experiment, step = scene(0.0)
    off = {"s0": {"fit": 3.0}}
    lost = replace(step, assessment=replace(step.assessment, adequate=False, ratio=off))
    assert not lost.explained and np.isfinite(lost.assessment.worst)
    assert narrowed(experiment, lost) is lost
    still = narrowed(experiment, step)
    assert narrowed(experiment, still) is still
