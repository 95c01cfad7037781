"""Faults of the measurement on the way from the simulation to the markers: a late clock, a drift, a scale."""

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from force_example import FPS, shaken_bar, soft_belief
from mphygs.capture.format import Load
from mphygs.capture.rotation import matrix_from_rotation_vector
from mphygs.model.belief import Belief
from mphygs.simulate.measurement import before_measurement
from mphygs.simulate.prediction import Prediction, Predictor, Settings

FREE = ("part0.youngs_modulus", "part1.density")
FRAMES = 12


@pytest.fixture(scope="module")
def predictor() -> Predictor:
    capture = shaken_bar(FRAMES, markers=12)
    return Predictor(capture, capture.sequences[0], Settings(0.015, dtype="float64", workers=1))


def late(predictor: Predictor, frames: float) -> Belief:
    belief = soft_belief(predictor.capture, free=FREE)
    return belief.with_effect("time_offset", {"offset": frames / FPS})


@pytest.mark.parametrize("frames", [-1.3, -0.6, 0.0, 0.4, 1.0])
def test_all_frames_are_shown_however_late_they_were_taken(predictor: Predictor, frames: float) -> None:
    prediction = predictor.predict(late(predictor, frames), last=7)
    assert prediction.frames.tolist() == list(range(7)) and len(prediction.position) == 7
    early = np.arange(7) / FPS + frames / FPS <= 0.0
    rest = predictor.predict(soft_belief(predictor.capture)).position[0]
    moved = np.abs(prediction.position - rest).max(axis=(1, 2))
    assert (moved[early] < 1e-15).all() and (moved[2:] > 0.0).all()


def test_a_clock_one_frame_late_shows_the_next_frame_to_the_last(predictor: Predictor) -> None:
    plain = predictor.predict(soft_belief(predictor.capture))
    seen = predictor.predict(late(predictor, 1.0), last=FRAMES - 1)
    # Only the substeps of the first span differ.
    np.testing.assert_allclose(seen.position, plain.position[1:], atol=2e-6)
    # The last frame as well, though the recording of the hold ends there: it goes on.
    whole = predictor.predict(late(predictor, 0.5))
    step = np.abs(whole.position[-1] - plain.position[-1]).max(axis=1)
    assert (step > 1e-4).all(), "the last frame should not stand still"


def test_between_frames_a_late_clock_shows_what_finer_frames_do(
    predictor: Predictor, monkeypatch: pytest.MonkeyPatch
) -> None:
    times = np.arange(2 * FRAMES) / (2 * FPS)
    fine = replace(predictor.recording, fps=2 * FPS, frames=2 * FRAMES, held=tuple(
        replace(
            hold,
            position=hold.poses(times, FPS)[1],
            quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (2 * FRAMES, 1)),
        )
        for hold in predictor.recording.held
    ))  # fmt: skip
    shape = (2 * FRAMES, *fine.markers.position.shape[1:])
    fine = replace(fine, markers=replace(fine.markers, position=np.zeros(shape)))
    other = Predictor(predictor.capture, fine, predictor.settings)
    # Of the same substep, which half a frame has to hold a whole number of.
    for one in (predictor, other):
        monkeypatch.setattr(one, "stable_substep", lambda _belief: 1.0001 / (26 * FPS))
    exact = other.predict(soft_belief(predictor.capture)).position[1:-2:2]
    seen = predictor.predict(late(predictor, 0.5), last=FRAMES - 1).position
    still = predictor.predict(soft_belief(predictor.capture), last=FRAMES - 1).position
    np.testing.assert_allclose(seen, exact, atol=2e-6)
    assert np.abs(still - exact).max() > 1e-3


@pytest.mark.parametrize("frames", [-0.7, 0.4, 1.3])
def test_derivatives_under_a_late_clock_follow_differences(predictor: Predictor, frames: float) -> None:
    belief = late(predictor, frames)
    keys = tuple(p.key for p in belief.free)
    assert keys == (*FREE, "time_offset.offset")
    # The substeps of the first span stretch with the offset: the shorter they are the less that shows.
    substep = 0.05 * predictor.stable_substep(belief)

    def at(coordinates: np.ndarray, **options: object) -> Prediction:
        return predictor.predict(belief.at(coordinates), last=8, substep=substep, **options)

    jacobian = at(belief.coordinates, keys=keys).jacobian
    for slot, key in enumerate(keys):
        step = 1e-5 * np.eye(len(keys))[slot]
        change = (at(belief.coordinates + step).position - at(belief.coordinates - step).position) / 2e-5
        assert np.abs(change).max() > 1e-6, key
        near = (5e-3 if key == "time_offset.offset" else 1e-4) * np.abs(change).max()
        np.testing.assert_allclose(jacobian[..., slot], change, atol=near, err_msg=key)


def test_markers_on_a_hold_are_seen_where_it_is_then(predictor: Predictor) -> None:
    recording = predictor.recording
    at = np.array([[0.0, 0.004, 0.01], [0.0, 0.01, 0.004]])
    held = replace(recording, markers=replace(recording.markers, at=at, position=np.zeros((FRAMES, 2, 3))))
    one = Predictor(predictor.capture, held, predictor.settings)
    seen = one.predict(late(predictor, 0.4)).position
    _, shift = recording.held[0].poses((np.arange(FRAMES) + 0.4) / FPS, FPS)
    np.testing.assert_allclose(seen, at + shift[:, None], atol=1e-12)
    assert np.abs(seen - one.predict(soft_belief(predictor.capture)).position).max() > 5e-4


@pytest.mark.parametrize("frames", [-0.4, 0.4])
@pytest.mark.parametrize("since", [0, 3])
def test_a_late_clock_shows_a_load_s_motion_later(since: int, frames: float) -> None:
    pull = Load(np.array([[0.04, -1.0, -1.0], [1.0, 1.0, 1.0]]), np.array([0.0, 0.02, 0.0]), since)
    at = np.array([[0.05, 0.01, 0.01], [0.03, 0.01, 0.01]])
    capture = bar_capture(frames=10, fps=FPS, loads=(pull,), markers_at=at, gravity=np.zeros(3))
    one = Predictor(capture, capture.sequences[0], Settings(0.01, dtype="float64", workers=1))
    plain = bar_belief(capture, youngs_modulus=6e4, free=())
    belief = plain.with_effect("time_offset", {"offset": frames / FPS})
    substep = 0.05 * one.stable_substep(belief)
    jacobian = one.predict(belief, keys=("time_offset.offset",), substep=substep).jacobian[..., 0]
    sides = [
        one.predict(belief.at(belief.coordinates + d), substep=substep).position for d in (1e-4, -1e-4)
    ]
    change = (sides[0] - sides[1]) / 2e-4
    assert np.abs(change).max() > 1e-4
    # Of the interval in which it starts only the impulse is right: a tenth is lost with its shape.
    far = np.arange(10) > since + 1
    np.testing.assert_allclose(jacobian[far], change[far], atol=0.12 * np.abs(change).max())
    moved = np.abs(one.predict(belief, substep=substep).position - at).max(axis=(1, 2))
    assert (moved[np.arange(10) + frames <= since] < 1e-9).all() and moved[-1] > 1e-4


# Fast enough that nothing of it is small: 57 degrees a second about an oblique axis, over 12 frames.
DRIFT = {"v_x": 0.05, "v_y": -0.02, "v_z": 0.01, "w_x": 0.6, "w_y": -0.3, "w_z": 0.7}


def faulty(predictor: Predictor, *, clock: bool = False) -> Belief:
    belief = late(predictor, 0.4) if clock else soft_belief(predictor.capture, free=FREE)
    return belief.with_effect("frame_drift", DRIFT).with_effect("length_scale", {"scale": 0.1})


def test_a_drifting_frame_moves_rigidly_and_its_scale_is_that_of_what_it_shows(predictor: Predictor) -> None:
    plain, seen = (predictor.predict(b) for b in (soft_belief(predictor.capture), faulty(predictor)))
    times = np.arange(FRAMES) / FPS
    turning, shift = (np.array([DRIFT[f"{kind}_{a}"] for a in "xyz"]) for kind in "wv")
    rotation = matrix_from_rotation_vector(times[:, None] * turning)
    position, velocity = (np.einsum("tij,tmj->tmi", rotation, a) for a in (plain.position, plain.velocity))
    np.testing.assert_allclose(seen.position, 1.1 * (position + times[:, None, None] * shift), atol=1e-15)
    # Its velocity is that of the markers in the drifting frame.
    velocity = velocity + np.cross(turning, position) + shift
    np.testing.assert_allclose(seen.velocity, 1.1 * velocity, atol=1e-14)


def test_derivatives_in_a_drifting_frame_of_a_wrong_scale_follow_differences(predictor: Predictor) -> None:
    belief = faulty(predictor)
    keys = tuple(p.key for p in belief.free)
    assert len(keys) == 9
    jacobian = predictor.predict(belief, keys=keys).jacobian
    for slot, key in enumerate(keys):
        step = 1e-5 * np.eye(len(keys))[slot]
        sides = [predictor.predict(belief.at(belief.coordinates + d)).position for d in (step, -step)]
        change = (sides[0] - sides[1]) / 2e-5
        assert np.abs(change).max() > 1e-6, key
        np.testing.assert_allclose(jacobian[..., slot], change, atol=1e-6 * np.abs(change).max(), err_msg=key)


def test_a_late_clock_in_a_drifting_frame_shows_the_turned_velocity(predictor: Predictor) -> None:
    beliefs = late(predictor, 0.4), faulty(predictor, clock=True)
    own, seen = (predictor.predict(b, keys=("time_offset.offset",)).jacobian[..., 0] for b in beliefs)
    turning = np.array([DRIFT[f"w_{a}"] for a in "xyz"])
    rotation = matrix_from_rotation_vector(np.arange(len(own))[:, None] / FPS * turning)
    np.testing.assert_allclose(seen, 1.1 * np.einsum("tij,tmj->tmi", rotation, own), atol=1e-13)


def test_the_adjoint_of_the_faults_is_the_transpose_of_their_tangent(predictor: Predictor) -> None:
    belief, plain = faulty(predictor), soft_belief(predictor.capture, free=FREE)
    tangent = [predictor.predict(b, keys=FREE).jacobian for b in (plain, belief)]
    bar = np.random.default_rng(0).standard_normal(tangent[1].shape[:3])
    back = before_measurement(belief, np.arange(FRAMES) / FPS, bar)
    ours, theirs = (np.einsum("tmc,tmck->k", b, j) for b, j in ((bar, tangent[1]), (back, tangent[0])))
    assert np.abs(ours).min() > 1e-6
    np.testing.assert_allclose(theirs, ours, rtol=1e-10)
