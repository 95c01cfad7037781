"""Feedback from the measurement: what pulls a prediction, and its derivatives."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SIGMA, recorded
from mphygs.commands.options import _with_values
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.measurement import with_measurement_faults
from mphygs.simulate.prediction import Predictor, Settings

SPACING, FRAMES, FPS = 0.01, 20, 80.0
SETTINGS = Settings(SPACING, workers=1, dtype="float64")
FREE = ("part0.youngs_modulus", "part1.youngs_modulus")
BOTH = pytest.mark.parametrize("transfer", ["total-lagrangian", "mls"])


@cache
def scene(dtype: str = "float64", transfer: str = "total-lagrangian") -> tuple[Problem, Belief]:
    """A shaken bar of two parts that drags through the air, and its elastic model."""
    shake = 0.008 * np.sin(np.linspace(0.0, 12.0, FRAMES))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(
        lengths=(0.03, 0.03), frames=FRAMES, fps=FPS, motion=shake, fit=(0, FRAMES), sigma=SIGMA
    )
    truth = bar_belief(capture, youngs_modulus=5e4, free=FREE)
    made = recorded(capture, truth.with_effect("mass_damping", {"alpha": 8.0}))
    settings = Settings(SPACING, workers=1, dtype=dtype, transfer=transfer)
    return Experiment.of(made, settings).problem(SPACING), truth


@BOTH
def test_a_model_that_lacks_something_stays_near_the_measurement(transfer: str) -> None:
    problem, truth = scene(transfer=transfer)
    wrong = truth.with_parameter(FREE[0], value=1e5)
    free = problem.evaluate(wrong, jacobian=False).misfit
    misfits = [problem.under(g).evaluate(wrong, jacobian=False).misfit for g in (0.1, 1.0)]
    assert free > 10.0 and misfits[1] < misfits[0] < free and misfits[1] < 0.3 * free


@BOTH
def test_no_gain_is_a_free_run(transfer: str) -> None:
    problem, truth = scene(transfer=transfer)
    again = problem.under(1.0).under(0.0)
    free, same = (p.evaluate(truth, jacobian=False).residual for p in (problem, again))
    assert np.array_equal(free, same)
    for gain, shown in ((2.0, "2"), (-0.5, "-0.5"), (np.nan, "nan")):
        with pytest.raises(ValueError, match=f"feedback {shown}: expected a gain from 0"):
            problem.under(gain).evaluate(truth, jacobian=False)


@BOTH
def test_a_pull_of_no_gain_is_a_free_run_to_the_bit_in_the_core(transfer: str) -> None:
    problem, truth = scene(transfer=transfer)
    wrong = truth.with_parameter(FREE[0], value=1e5)

    def seen(gain: float | None) -> np.ndarray:
        # A predictor of its own: nothing is kept from another run.
        predictor = Predictor(problem.capture, problem.capture.sequence("a"), problem.settings)
        timeline = predictor.timeline(wrong, FRAMES, predictor.stable_substep(wrong))
        fields, observer = predictor.inputs(wrong, timeline), None
        if gain is not None:
            feedback = predictor.pulled_by(problem.observations["a"].position, gain)
            fields = fields | {"target": feedback.target(wrong, timeline)}
            observer = feedback.observer(timeline)
        model = predictor.model_of(wrong)
        return predictor.transfer.simulate(model, fields, timeline.schedule, None, None, observer)[0]

    free = seen(None)
    assert np.array_equal(free, seen(0.0)) and np.abs(free - seen(1.0)).max() > 1e-4


@BOTH
def test_jacobians_under_feedback_follow_differences(transfer: str) -> None:
    problem, truth = scene(transfer=transfer)
    belief = (
        truth.with_effect("viscosity", {"eta": 3.0}).with_effect("length_scale").with_effect("frame_drift")
    )
    pulled = replace(problem.under(1.0), substep=0.8 * problem.stable_substep(belief))
    jacobian, step = pulled.evaluate(belief).jacobian, 1e-5
    owners = {parameter.key.rsplit(".", 1)[0] for parameter in belief.free}
    assert owners == {"part0", "part1", "viscosity", "length_scale", "frame_drift"}
    for k, parameter in enumerate(belief.free):
        ends = []
        for sign in (1.0, -1.0):
            at = belief.coordinates
            at[k] += sign * step
            ends.append(pulled.evaluate(belief.at(at), jacobian=False).residual)
        slope = (ends[0] - ends[1]) / (2.0 * step)
        error = np.linalg.norm(jacobian[:, k] - slope)
        assert 0.0 < np.linalg.norm(slope) and error < 1e-6 * np.linalg.norm(slope), parameter.key


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


def test_targets_of_a_cubic_motion_are_that_motion_between_frames_too() -> None:
    problem, truth = scene()
    predictor, rest = problem.predictors["a"], problem.observations["a"].position[0]
    power = np.array([[0.01, 0.0, -0.02], [0.1, 0.2, 0.0], [-0.8, 0.3, 0.5], [2.0, -1.0, 1.5]])

    def moved(times: np.ndarray) -> np.ndarray:
        return times[..., None] ** np.arange(4) @ power

    position = rest + moved(np.arange(FRAMES) / FPS)[:, None]
    position[9:11, 1] = np.nan  # a cubic goes on through a gap as well
    feedback = predictor.pulled_by(position, 1.0)
    timeline = predictor.timeline(truth, FRAMES, predictor.stable_substep(truth))
    target = feedback.target(truth, timeline)
    begin, offset = timeline.times - timeline.spans, (rest - feedback.rest)[feedback.free]
    for share in (0.0, 0.25, 0.5, 0.9, 1.0):
        place = np.einsum("fmkc,k->fmc", target, share ** np.arange(4))
        wanted = moved(begin + share * timeline.spans)[:, None] + offset
        assert np.allclose(place, wanted, atol=1e-11), share


def test_a_marker_that_is_hardly_seen_does_not_pull() -> None:
    problem, truth = scene()
    predictor = problem.predictors["a"]
    before = predictor.pulled_by(problem.observations["a"].position, 1.0).free
    assert before[2]
    position = problem.observations["a"].position.copy()
    position[3:, 2] = np.nan
    feedback = predictor.pulled_by(position, 1.0)
    assert list(np.flatnonzero(before != feedback.free)) == [2]
    timeline = predictor.timeline(truth, FRAMES, predictor.stable_substep(truth))
    count = int(before.sum()) - 1
    assert feedback.rows.shape[0] == count and feedback.reach.shape[1] in (count, 3 * count)
    assert feedback.target(truth, timeline).shape == (FRAMES - 1, count, 4, 3)
    assert feedback.observer(timeline).share.shape == (FRAMES - 1, count)


def test_rows_of_markers_that_stand_off_are_what_is_observed() -> None:
    # Markers on the material, beside it and above it, in both parts.
    at = np.array([[0.05, 0.01, 0.01], [0.05, 0.01, 0.024], [0.02, -0.003, 0.01], [0.04, 0.023, 0.022]])
    capture = bar_capture(lengths=(0.03, 0.03), frames=FRAMES, fps=FPS, markers_at=at)
    truth = bar_belief(capture, youngs_modulus=5e4)
    predictor = Predictor(capture, capture.sequence("a"), SETTINGS)
    feedback = predictor.pulled_by(capture.sequence("a").markers.position, 1.0)
    timeline = predictor.timeline(truth, FRAMES, predictor.stable_substep(truth))
    assert feedback.free.all() and np.abs(predictor.carriers.attachment.offset).max() > 2e-3
    places = predictor.transfer.places_at_rest()
    # A small turn and a shift: what stands off turns with the material.
    turn = 1e-6 * np.array([[0.0, 0.3, -0.2], [-0.3, 0.0, 0.5], [0.2, -0.5, 0.0]])
    shift = 1e-6 * np.array([0.01, -0.02, 0.03])
    nodes = places @ turn + shift
    states = (np.tile(nodes, (FRAMES, 1, 1)), np.zeros((FRAMES, *nodes.shape)))
    observed = predictor.carriers.observe(states, timeline, capture.sequence("a"))[0]
    assert np.abs(observed - at).max() > 1e-9
    assert np.allclose(feedback.rows @ nodes, observed[-1] - at, rtol=0.0, atol=1e-13)
    slope = 0.01 * np.arange(9.0).reshape(3, 3) - 0.03
    assert np.allclose(feedback.rows @ (places @ slope), feedback.rest @ slope, atol=1e-12)


@BOTH
def test_rows_are_the_markers(transfer: str) -> None:
    problem, _ = scene(transfer=transfer)
    predictor = problem.predictors["a"]
    feedback = predictor.pulled_by(problem.observations["a"].position, 1.0)
    places = predictor.transfer.places_at_rest()
    slope = np.array([[0.01, 0.02, 0.0], [-0.03, 0.01, 0.02], [0.0, 0.01, -0.02]])
    # Every part has nodes of its own: an affine displacement is the same on all of them.
    assert np.allclose(feedback.rows @ (places @ slope), feedback.rest[feedback.free] @ slope, atol=1e-6)


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


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("length_scale", {"scale": 0.05}),
        ("frame_drift", {"v_x": 0.02, "v_z": -0.01}),
        ("frame_drift", {"v_y": 0.01, "w_x": 0.1, "w_y": -0.2, "w_z": 0.3}),
    ],
)
def test_what_a_fault_shows_is_pulled_to_where_it_truly_was(effect: str, values: dict[str, float]) -> None:
    problem, truth = scene()
    predictor, position = problem.predictors["a"], problem.observations["a"].position
    timeline = predictor.timeline(truth, FRAMES, predictor.stable_substep(truth))
    clean = predictor.pulled_by(position, 1.0).target(truth, timeline)
    faulty = truth.with_effect(effect, values)
    times, still = np.arange(FRAMES) / FPS, np.zeros_like(position)
    shown = with_measurement_faults(faulty, [], times, position, still, np.zeros((*position.shape, 0)))[0]
    feedback = predictor.pulled_by(shown, 1.0)
    assert np.abs(feedback.target(truth, timeline) - clean).max() > 1e-3
    assert np.allclose(feedback.target(faulty, timeline), clean, atol=1e-12)


def test_the_option_stands_with_a_number_and_without() -> None:
    assert _with_values(["run", "--feedback", "--json"]) == ["run", "--feedback", "1", "--json"]
    assert _with_values(["run", "--feedback", "0.3"]) == ["run", "--feedback", "0.3"]
    assert _with_values(["run", "--feedback"]) == ["run", "--feedback", "1"]
