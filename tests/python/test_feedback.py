"""Feedback from the measurement: what pulls a prediction, and its derivatives."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SIGMA, recorded
from mphygs.command import _with_values
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Settings

SPACING, FRAMES = 0.01, 20
FREE = ("part0.youngs_modulus", "part1.youngs_modulus")


@cache
def scene(dtype: str = "float64", transfer: str = "total-lagrangian") -> tuple[Problem, Belief]:
    """A shaken bar of two parts that drags through the air, and its elastic model."""
    shake = 0.008 * np.sin(np.linspace(0.0, 12.0, FRAMES))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(
        lengths=(0.03, 0.03), frames=FRAMES, fps=80.0, motion=shake, fit=(0, FRAMES), sigma=SIGMA
    )
    truth = bar_belief(capture, youngs_modulus=5e4, free=FREE)
    made = recorded(capture, truth.with_effect("mass_damping", {"alpha": 8.0}))
    settings = Settings(SPACING, workers=1, dtype=dtype, transfer=transfer)
    return Experiment.of(made, settings).problem(SPACING), truth


def test_a_model_that_lacks_something_stays_near_the_measurement() -> None:
    problem, truth = scene()
    wrong = truth.with_parameter(FREE[0], value=1e5)
    free = problem.evaluate(wrong, jacobian=False).misfit
    misfits = [problem.under(g).evaluate(wrong, jacobian=False).misfit for g in (0.1, 1.0)]
    assert free > 10.0 and misfits[1] < misfits[0] < free and misfits[1] < 0.3 * free


def test_no_gain_is_a_free_run() -> None:
    problem, truth = scene()
    again = problem.under(1.0).under(0.0)
    free, same = (p.evaluate(truth, jacobian=False).residual for p in (problem, again))
    assert np.array_equal(free, same)
    with pytest.raises(ValueError, match="feedback 2: expected a gain from 0"):
        problem.under(2.0).evaluate(truth, jacobian=False)


def test_jacobians_under_feedback_follow_differences() -> None:
    problem, truth = scene()
    belief = (
        truth.with_effect("viscosity", {"eta": 3.0}).with_effect("length_scale").with_effect("frame_drift")
    )
    pulled = replace(problem.under(1.0), substep=0.8 * problem.stable_substep(belief))
    jacobian, step = pulled.evaluate(belief).jacobian, 1e-5
    for k, parameter in enumerate(belief.free):
        ends = []
        for sign in (1.0, -1.0):
            at = belief.coordinates
            at[k] += sign * step
            ends.append(pulled.evaluate(belief.at(at), jacobian=False).residual)
        slope = (ends[0] - ends[1]) / (2.0 * step)
        error = np.linalg.norm(jacobian[:, k] - slope)
        assert 0.0 < np.linalg.norm(slope) and error < 1e-5 * np.linalg.norm(slope), parameter.key


def test_targets_pass_through_the_measured_frames_and_gaps_do_not_pull() -> None:
    problem, truth = scene()
    predictor = problem.predictors["a"]
    position = problem.observations["a"].position.copy()
    position[7, 2] = np.nan
    feedback = predictor.pulled_by(position, 1.0)
    timeline = predictor.timeline(truth, FRAMES, predictor.stable_substep(truth))
    target, observer = feedback.target(truth, timeline), feedback.observer(timeline)
    free = np.flatnonzero(feedback.free)
    moved = position[:, free] - feedback.rest[free]
    seen = np.isfinite(moved[:-1]) & np.isfinite(moved[1:])
    assert np.allclose(target[:, :, 0][seen], moved[:-1][seen], atol=1e-12)
    assert np.allclose(target.sum(2)[seen], moved[1:][seen], atol=1e-12)
    # The rate goes on from one interval to the next.
    rate = target @ np.eye(3)
    ahead = rate[:, :, 1] + 2.0 * rate[:, :, 2] + 3.0 * rate[:, :, 3]
    assert np.allclose(ahead[:-1], rate[1:, :, 1], atol=1e-9)
    column = int(np.flatnonzero(free == 2)[0])
    assert list(np.flatnonzero(observer.share[:, column] == 0.0)) == [6, 7]
    assert observer.share.sum() == observer.share.size - 2


def test_rows_are_the_markers_and_a_pull_is_shared_out() -> None:
    problem, _ = scene()
    predictor = problem.predictors["a"]
    feedback = predictor.pulled_by(problem.observations["a"].position, 1.0)
    places = predictor.transfer.places_at_rest()
    slope = np.array([[0.01, 0.02, 0.0], [-0.03, 0.01, 0.02], [0.0, 0.01, -0.02]])
    # Every part has nodes of its own: an affine displacement is the same on all of them.
    assert np.allclose(feedback.rows @ (places @ slope), feedback.rest[feedback.free] @ slope, atol=1e-6)
    total = np.asarray(feedback.reach.sum(1)).ravel()
    assert total.max() <= 1.0 + 1e-12 and total.max() > 0.5 and feedback.reach.min() >= 0.0


def test_faults_of_the_measurement_are_taken_off_the_targets() -> None:
    problem, truth = scene()
    predictor = problem.predictors["a"]
    position = problem.observations["a"].position
    timeline = predictor.timeline(truth, FRAMES, predictor.stable_substep(truth))
    clean = predictor.pulled_by(position, 1.0).target(truth, timeline)
    faulty = truth.with_effect("length_scale", {"scale": 0.05}).with_effect("frame_drift", {"v_x": 0.02})
    times = np.arange(FRAMES)[:, None, None] / 80.0
    shown = 1.05 * (position + times * np.array([0.02, 0.0, 0.0]))
    found = predictor.pulled_by(shown, 1.0).target(faulty, timeline)
    assert np.allclose(found, clean, atol=1e-12)


def test_mls_mpm_refuses_feedback_in_one_line() -> None:
    problem, truth = scene(transfer="mls")
    with pytest.raises(ValueError, match="does not run in MLS-MPM; expected the total-Lagrangian"):
        problem.under(1.0).evaluate(truth, jacobian=False)


def test_the_option_stands_with_a_number_and_without() -> None:
    assert _with_values(["run", "--feedback", "--json"]) == ["run", "--feedback", "1", "--json"]
    assert _with_values(["run", "--feedback", "0.3"]) == ["run", "--feedback", "0.3"]
    assert _with_values(["run", "--feedback"]) == ["run", "--feedback", "1"]
