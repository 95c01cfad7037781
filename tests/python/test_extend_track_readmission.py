"""Measurements that were left out and belong to the motion after all."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, recorded
from mphygs.compare.noise import Observation
from mphygs.extend import track_readmission
from mphygs.extend.conclusion import conclude
from mphygs.extend.step import Step
from mphygs.extend.steps import left_out_of, step_at, step_document
from mphygs.extend.track_readmission import FAULT, with_tracks_readmitted
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor, Settings

LEFT_OUT = 7  # frames of the first marker


@cache
def truth() -> tuple[object, Belief]:
    capture = bar_capture(frames=16, fps=100.0, fit=(0, 16))
    belief = bar_belief(capture, youngs_modulus=6e4, free=("part0.youngs_modulus",))
    return recorded(capture, belief.with_effect("viscosity", {"eta": 20.0})), belief


def masked(effect: bool) -> tuple[Experiment, Step]:
    """An experiment that uses all but a few measurements, and the model with or without what was hidden."""
    capture, belief = truth()
    experiment = Experiment.of(capture, Settings(SPACING, workers=1))
    experiment.problem(SPACING)
    whole = experiment.observations["a"]
    position = whole.position.copy()
    position[-LEFT_OUT:, 0] = np.nan
    experiment.observations["a"] = Observation(position, whole.noise, whole.weight)
    experiment.problems.clear()
    if effect:
        belief = belief.with_effect("viscosity", {"eta": 20.0})
    return experiment, step_at(experiment, belief, SPACING, added=("viscosity",))


def test_what_the_model_predicts_is_used_again() -> None:
    experiment, step = masked(effect=True)
    assert len(left_out_of(experiment)["a"]) == LEFT_OUT
    rows = step.solution.evaluation.data_rows
    said: list[str] = []
    found = with_tracks_readmitted(experiment, step, said.append)
    assert found.dropped == (FAULT,) and found.explained and left_out_of(experiment) == {}
    assert found.solution.evaluation.data_rows == rows + 3 * LEFT_OUT
    assert said == [f"{LEFT_OUT} measurements that were left out are as predicted: used again"]
    first = step_at(experiment, truth()[1], SPACING)
    fault = step_at(experiment, truth()[1], SPACING, added=(FAULT,))
    concluded = conclude([first, fault, found], [], [])
    assert (concluded.verdict, concluded.effects) == ("missing", ("viscosity",))
    assert step_document(found, experiment, (FAULT,))["effects"] == ["viscosity"]
    # Asked again there is nothing left to admit.
    assert with_tracks_readmitted(experiment, found) is found


def test_at_the_minimum_nothing_is_simulated_again(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, step = masked(effect=True)
    whole = Experiment.of(experiment.capture, Settings(SPACING, workers=1))
    belief = minimise(whole.problem(SPACING), step.belief, relative_tolerance=1e-6).belief
    step = step_at(experiment, belief, SPACING, added=("viscosity",))

    def run(*_: object, **__: object) -> None:
        raise AssertionError("simulated")

    with monkeypatch.context() as patch:
        patch.setattr(Predictor, "predict", run)
        found = with_tracks_readmitted(experiment, step)
    assert found.belief is step.belief and found.dropped == (FAULT,)
    anew = experiment.problem(SPACING).evaluate(found.belief)
    assert found.solution.evaluation.residual == pytest.approx(anew.residual)
    assert found.solution.evaluation.jacobian == pytest.approx(anew.jacobian)
    # From the minimum of those that were in use the others lead to that of all.
    experiment, step = masked(effect=True)
    belief = minimise(experiment.problem(SPACING), step.belief, relative_tolerance=1e-6).belief
    found = with_tracks_readmitted(experiment, step_at(experiment, belief, SPACING, added=("viscosity",)))
    costs = [whole.problem(SPACING).evaluate(b, jacobian=False).cost for b in (belief, found.belief)]
    assert found.dropped == (FAULT,) and costs[1] < costs[0] - 0.05


def test_tangents_of_another_grid_do_not_become_those_of_the_fit() -> None:
    experiment, step = masked(effect=True)
    lent = {
        name: replace(item, jacobian=0.5 * item.jacobian, tangents_of=2.0 * SPACING)
        for name, item in step.compared.items()
    }
    own = experiment.problem(SPACING).evaluate(step.belief)
    assert np.abs(own.jacobian).max() > 0.0
    found = track_readmission._as_it_is(experiment, replace(step, compared=lent))
    assert found.solution.evaluation.jacobian == pytest.approx(own.jacobian)
    assert found.compared["a"].jacobian is lent["a"].jacobian


def test_a_track_that_is_off_stays_out(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, step = masked(effect=True)

    def bad(residual: np.ndarray, *_: object) -> np.ndarray:
        out = np.zeros(residual.shape[:2], bool)
        out[-1, 0] = True
        return out

    monkeypatch.setattr(track_readmission, "bad_observations", bad)
    assert with_tracks_readmitted(experiment, step) is step
    assert len(left_out_of(experiment)["a"]) == LEFT_OUT


def test_what_would_no_longer_be_explained_stays_as_it_was() -> None:
    experiment, step = masked(effect=False)
    assert not step.explained
    assert with_tracks_readmitted(experiment, step) is step
    assert len(left_out_of(experiment)["a"]) == LEFT_OUT
