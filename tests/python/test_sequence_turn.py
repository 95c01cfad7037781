"""Sequences that are told in a frame that is turned against gravity's."""

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import DOWN, bar_belief, bar_capture
from mphygs.capture.format import Capture
from mphygs.capture.rotation import matrix_from_quaternion, quaternion_from_rotation_vector
from mphygs.fit.problem import Problem
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.settings import Settings

TURN = matrix_from_quaternion(quaternion_from_rotation_vector(np.array([0.5, 0.3, -0.2])))
FRAMES = 8
KEYS = [f"gravity.delta_g_{a}" for a in "xyz"]


def told(capture: Capture, turn: np.ndarray | None) -> Capture:
    """The capture with its sequence in a turned frame."""
    return replace(capture, sequences=tuple(replace(s, turn=turn) for s in capture.sequences))


@pytest.mark.parametrize("transfer", ["total-lagrangian", "mls"])
@pytest.mark.parametrize(("rest", "prestress"), [("stress-free", "off"), ("equilibrium", "paper")])
def test_gravity_is_turned_into_the_frame_of_the_sequence(transfer: str, rest: str, prestress: str) -> None:
    settings = Settings(spacing=0.01, transfer=transfer)
    direct = bar_capture(frames=FRAMES, gravity=TURN.T @ DOWN, rest=rest)
    capture = told(bar_capture(frames=FRAMES, rest=rest), TURN)
    tilt = {key.rsplit(".", 1)[1]: value for key, value in zip(KEYS, (0.4, -0.3, 0.8), strict=True)}
    own = dict(zip(tilt, TURN.T @ list(tilt.values()), strict=True))
    there = bar_belief(direct, prestress=prestress).with_effect("gravity", own)
    here = bar_belief(capture, prestress=prestress).with_effect("gravity", tilt)
    assert np.array_equal(here.gravity, DOWN)
    expected = Predictor(direct, direct.sequences[0], settings).predict(there, keys=KEYS)
    found = Predictor(capture, capture.sequences[0], settings).predict(here, keys=KEYS)
    moved = np.abs(expected.position - expected.position[0]).max()
    assert (moved > 1e-4) == (prestress == "off")
    assert found.position == pytest.approx(expected.position, abs=1e-9)
    # d / d delta of what R^T delta moves
    assert found.jacobian == pytest.approx(expected.jacobian @ TURN.T, abs=1e-9)
    assert np.abs(found.jacobian).max() > 1e-6 or prestress == "paper"


def test_equilibrium_is_held_in_the_turned_frame() -> None:
    settings = Settings(spacing=0.01)
    capture = told(bar_capture(frames=FRAMES, rest="equilibrium"), TURN)
    belief = bar_belief(capture, prestress="equilibrium", youngs_modulus=2e5)
    predictor = Predictor(capture, capture.sequences[0], settings)
    found = predictor.predict(belief)
    assert np.abs(found.position - found.position[0]).max() < 1e-7
    # by the shape that carries the turned weight, not the one of the capture's own frame
    direct = bar_capture(frames=FRAMES, rest="equilibrium", gravity=TURN.T @ DOWN)
    there = bar_belief(direct, prestress="equilibrium", youngs_modulus=2e5)
    expected = Predictor(direct, direct.sequences[0], settings).rest_shape.solve(there)
    for name, values in predictor.rest_shape.solve(belief).items():
        assert values == pytest.approx(expected[name], abs=1e-9)


def test_sequences_with_the_same_hold_and_unlike_frames_share_no_gravity() -> None:
    capture = bar_capture(frames=FRAMES, fit=(0, FRAMES))
    one = capture.sequences[0]
    both = replace(capture, sequences=(one, replace(one, name="b", turn=TURN)))
    belief = bar_belief(both)
    problem = Problem(both, Settings(spacing=0.01), {"a": (0, FRAMES), "b": (0, FRAMES)}, {})
    moved = {n: p.predict(belief).position for n, p in problem.predictors.items()}
    direct = bar_capture(frames=FRAMES, gravity=TURN.T @ DOWN)
    expected = Predictor(direct, direct.sequences[0], Settings(spacing=0.01)).predict(bar_belief(direct))
    assert moved["b"] == pytest.approx(expected.position, abs=1e-9)
    assert np.abs(moved["a"] - moved["b"]).max() > 1e-4
