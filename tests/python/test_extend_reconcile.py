"""What unseen frames show beside what the fitted ones leave open."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import recorded
from mphygs.extend import finer_grid
from mphygs.extend.reconcile import on_all_frames, reconciled
from mphygs.extend.step import Step
from mphygs.extend.steps import step_at
from mphygs.fit.experiment import Experiment
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Prediction, Predictor, Settings

FREE = ("part0.youngs_modulus",)
SPACING = 0.01


@cache
def scene(damping: float = 0.0) -> tuple[Experiment, Belief]:
    """A bar let go at rest: the first frames hardly tell its stiffness. It has a wall, out of reach."""
    capture = bar_capture(frames=24, fps=100.0, fit=(0, 4))
    sequence = replace(capture.sequences[0], predict=(4, 24))
    capture = replace(capture, sequences=(sequence,))
    elastic = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    truth = elastic.with_effect("mass_damping", {"alpha": damping}) if damping else elastic
    experiment = Experiment.of(recorded(capture, truth, SPACING), Settings(SPACING, workers=1))
    wall = elastic.with_effect("contact", {"d": -1.0, "n_x": 0.0, "n_y": 0.0, "n_z": 1.0})
    return experiment, replace(
        wall, parameters=tuple(replace(p, free=p.key in FREE) for p in wall.parameters)
    )


def off(damping: float = 0.0) -> tuple[Experiment, Step]:
    """The step of a stiffness that the fitted frames do not refute and the others do."""
    experiment, truth = scene(damping)
    return experiment, step_at(experiment, truth.with_parameter(FREE[0], value=6.3e4), SPACING)


def test_all_compared_frames_are_fitted() -> None:
    whole = on_all_frames(scene()[0])
    assert whole.fitted == {"a": (0, 24)}
    assert scene()[0].fitted == {"a": (0, 4)}


def test_what_the_fitted_frames_leave_open_is_not_missing() -> None:
    experiment, step = off()
    assert step.assessment.ratio["a"]["fit"] < 1.2 < step.assessment.ratio["a"]["predict"]
    assert not step.explained
    said: list[str] = []
    after = reconciled(experiment, step, said.append)
    assert after.explained and after.reconciled
    # The numbers stay those of the fitted frames.
    assert after.belief is step.belief and after.assessment is step.assessment
    assert "leave open" in said[-1]


@pytest.mark.parametrize("damping", [0.0, 2.0])
def test_the_screening_grid_is_asked_first(monkeypatch: pytest.MonkeyPatch, damping: float) -> None:
    """Where its tangents lead to an explanation, no others are taken; where they do not, those decide."""
    experiment, step = off(damping)
    asked: set[float] = set()
    predict = Predictor.predict

    def counted(self: Predictor, *given: object, **named: object) -> Prediction:
        if named.get("keys"):
            asked.add(self.settings.spacing)
        return predict(self, *given, **named)

    monkeypatch.setattr(Predictor, "predict", counted)
    monkeypatch.setattr(finer_grid, "screening_spacing", lambda _capture: 1.4 * SPACING)
    after = reconciled(experiment, step, None)
    assert after.reconciled == (damping == 0.0)
    assert asked == ({1.4 * SPACING} if damping == 0.0 else {SPACING, 1.4 * SPACING})


def test_what_is_missing_stays_missing() -> None:
    experiment, step = off(damping=2.0)
    # Seen from the stiffness that the fitted frames allow, all others are far off.
    assert step.assessment.ratio["a"]["fit"] < 1.26 and step.assessment.ratio["a"]["predict"] > 3.0
    said: list[str] = []
    after = reconciled(experiment, step, said.append)
    assert not after.explained
    assert "something is missing" in said[-1]


def test_fitted_frames_that_are_off_are_not_asked_again() -> None:
    experiment, truth = scene()
    step = step_at(experiment, truth.with_parameter(FREE[0], value=3e4), SPACING)
    assert step.assessment.ratio["a"]["fit"] > 1.3
    assert reconciled(experiment, step, None) is step


def test_smooth_models_have_no_such_excuse() -> None:
    experiment, step = off()
    smooth = replace(step, belief=step.belief.without_effect("contact"))
    assert not smooth.explained and reconciled(experiment, smooth, None) is smooth


def test_an_explained_step_is_left_alone() -> None:
    experiment, truth = scene()
    step = step_at(experiment, truth, SPACING)
    assert step.explained and reconciled(experiment, step, None) is step


def test_the_same_numbers_again() -> None:
    experiment, step = off()
    first, second = (reconciled(experiment, step, None) for _ in range(2))
    assert first.reconciled == second.reconciled
    np.testing.assert_array_equal(first.belief.coordinates, second.belief.coordinates)
