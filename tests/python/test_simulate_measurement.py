"""Faults of the measurement on the way from the simulation to the markers: what a late clock shows."""

import numpy as np
import pytest

from force_example import FPS, shaken_bar, soft_belief
from mphygs.model.belief import Belief
from mphygs.simulate.measurement import frames_beyond
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


@pytest.mark.parametrize(("frames", "beyond"), [(-0.6, 0), (0.0, 0), (0.4, 1), (1.0, 1), (1.2, 2)])
def test_as_many_frames_more_are_simulated_as_the_offset_reaches(
    predictor: Predictor, frames: float, beyond: int
) -> None:
    assert frames_beyond(late(predictor, frames), FPS) == beyond
    assert frames_beyond(soft_belief(predictor.capture), FPS) == 0
    prediction = predictor.predict(late(predictor, frames), last=7)
    assert prediction.frames.tolist() == list(range(7)) and len(prediction.position) == 7


def test_a_clock_one_frame_late_shows_the_next_frame_to_the_last(predictor: Predictor) -> None:
    plain = predictor.predict(soft_belief(predictor.capture))
    seen = predictor.predict(late(predictor, 1.0), last=FRAMES - 1)
    np.testing.assert_allclose(seen.position, plain.position[1:], atol=1e-12)
    np.testing.assert_allclose(seen.velocity, plain.velocity[1:], atol=1e-9)
    # Those on the hold have what the hold will have: it goes on after the recording.
    free = predictor.carriers.free
    whole = predictor.predict(late(predictor, 0.5))
    still = np.abs(whole.position[-1] - plain.position[-1]).max(axis=1)
    assert (still[free] > 1e-4).all(), "the last frame should not stand still"


def test_between_frames_a_late_clock_shows_what_finer_frames_do(predictor: Predictor) -> None:
    seen = predictor.predict(late(predictor, 0.5), last=FRAMES - 1)
    before, after = (predictor.predict(late(predictor, f), last=FRAMES - 1) for f in (0.0, 1.0))
    step = after.position - before.position
    # A third-order rule between two frames: nearer than a straight line by far.
    middle = (before.position + after.position) / 2 + (before.velocity - after.velocity) / (8 * FPS)
    np.testing.assert_allclose(seen.position, middle, atol=1e-12)
    assert np.abs(step).max() > 1e-3


@pytest.mark.parametrize("frames", [-0.7, 0.4, 1.3])
def test_derivatives_under_a_late_clock_follow_differences(predictor: Predictor, frames: float) -> None:
    belief = late(predictor, frames)
    keys = tuple(p.key for p in belief.free)
    assert keys == (*FREE, "time_offset.offset")
    substep = predictor.stable_substep(belief)

    def at(coordinates: np.ndarray, **options: object) -> Prediction:
        return predictor.predict(belief.at(coordinates), last=8, substep=substep, **options)

    jacobian = at(belief.coordinates, keys=keys).jacobian
    for slot, key in enumerate(keys):
        step = 1e-5 * np.eye(len(keys))[slot]
        change = (at(belief.coordinates + step).position - at(belief.coordinates - step).position) / 2e-5
        assert np.abs(change).max() > 1e-6, key
        np.testing.assert_allclose(jacobian[..., slot], change, atol=1e-3 * np.abs(change).max(), err_msg=key)
