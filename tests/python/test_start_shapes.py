"""Starts away from rest: bent shapes, the state that they give, and its derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bar_capture import bar_belief, bar_capture
from mphygs.capture.format import Capture
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.body import hold_boxes
from mphygs.simulate.discretisation import discretise
from mphygs.simulate.measured_start import start_keys
from mphygs.simulate.prediction import Predictor, Settings
from mphygs.simulate.start_shapes import HeldAt, StartOnGrid, composed, start_shapes

LENGTH = 0.06
STILL = HeldAt.of((), 0.0, 1.0)


def moved_bar(**changes: object) -> Capture:
    """A bar of two parts whose hold moves from the first frame on."""
    motion = 0.004 * np.sin(np.linspace(0.5, 3.0, 12))[:, None] * [0.3, 1.0, 0.4]
    return bar_capture(lengths=(0.03, 0.03), frames=12, fps=60.0, motion=motion, **changes)


def begun(belief: Belief, amplitude: list[float], speed: list[float]) -> Belief:
    """The belief with a start that is fitted."""
    keys, values = start_keys("a", len(amplitude)), [*amplitude, *speed]
    added = tuple(Parameter(key, value, "m", scale=0.01) for key, value in zip(keys, values, strict=True))
    return replace(belief, parameters=belief.parameters + added)


def test_a_rotation_is_composed_as_one() -> None:
    for vector in ([0.0, 0.0, 0.0], [1e-5, 2e-4, 0.0], [0.3, -1.1, 0.7], [3.0, 0.2, 0.0]):
        spin = np.cross(np.eye(3), vector)
        expected = Rotation.from_rotvec(vector).as_matrix()
        np.testing.assert_allclose(composed(spin), expected, atol=1e-14)
        np.testing.assert_allclose(composed(spin + 0.1 * np.eye(3)), 1.1 * expected, atol=1e-14)


def test_a_bent_bar_keeps_its_length_and_stays_in_its_hold() -> None:
    capture = bar_capture(lengths=(LENGTH,))
    shapes = start_shapes(capture, hold_boxes(capture.sequences[0]))
    grid = StartOnGrid(shapes, shapes.body)
    axis = np.stack([np.linspace(0.0, LENGTH, 13), *np.full((2, 13), 0.01)], axis=1)
    node, value, _ = shapes.model.weights(axis, shapes.body.nearest_cell(axis))
    for amplitude in (0.005, 0.03):
        displacement, _ = grid.state(np.array([amplitude]), np.zeros(1), STILL)
        line = axis + np.einsum("pn,pnc->pc", value, displacement[node])
        length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
        assert abs(length / LENGTH - 1.0) < 0.005 and np.linalg.norm(line[0] - axis[0]) < 1e-4
        assert np.linalg.norm(line[-1] - axis[-1]) == pytest.approx(amplitude, rel=0.15)


def test_shapes_mean_the_same_on_every_grid() -> None:
    capture = bar_capture(lengths=(0.03, 0.03))
    boxes = hold_boxes(capture.sequences[0])
    shapes = start_shapes(capture, boxes)
    points = np.random.default_rng(0).uniform([0.002, 0.002, 0.002], [0.058, 0.018, 0.018], (40, 3))
    seen = []
    for spacing in (0.004, 0.006, 0.01):
        body = discretise(capture, boxes, spacing)
        grid = StartOnGrid(shapes, body)
        predictor = Predictor(capture, capture.sequences[0], Settings(spacing), body=body)
        node, value, _ = predictor.transfer._plain().weights(points, body.nearest_cell(points))
        state = grid.state(np.array([0.008, 0.004, 0.001]), np.array([0.2, 0.0, -0.1]), STILL)
        seen.append(np.concatenate([np.einsum("pn,pnc->pc", value, f[node]) for f in state], axis=1))
    for other in seen[1:]:
        assert np.abs(other - seen[0]).max(0) == pytest.approx(0.0, abs=0.05 * np.abs(seen[0]).max())


@pytest.mark.parametrize("transfer", ["total-lagrangian", "mls"])
@pytest.mark.parametrize("rest", ["stress-free", "equilibrium"])
def test_jacobians_follow_differences(transfer: str, rest: str) -> None:
    capture = moved_bar(rest=rest)
    settings = Settings(0.01, workers=1, dtype="float64", transfer=transfer)
    predictor = Predictor(capture, capture.sequences[0], settings)
    prestress = "equilibrium" if rest == "equilibrium" else "off"
    belief = bar_belief(capture, youngs_modulus=5e4, free=("part0.youngs_modulus",), prestress=prestress)
    belief = begun(belief, [0.006, -0.003], [0.2, 0.1]).with_effect("time_offset", {"offset": 0.003})
    substep = 0.5 * predictor.stable_substep(belief)
    keys = [p.key for p in belief.free]
    jacobian = predictor.predict(belief, keys=keys, substep=substep).jacobian
    for k, parameter in enumerate(belief.free):
        # The slope by a late clock is a difference itself.
        step, near = (3e-3, 2e-2) if parameter.key == "time_offset.offset" else (1e-6, 1e-5)
        ends = []
        for sign in (1.0, -1.0):
            at = belief.coordinates
            at[k] += sign * step
            ends.append(predictor.predict(belief.at(at), substep=substep).position)
        slope = (ends[0] - ends[1]) / (2.0 * step)
        error = np.linalg.norm(jacobian[..., k] - slope)
        assert 0.0 < np.linalg.norm(slope) and error < near * np.linalg.norm(slope), parameter.key


def test_the_first_frame_shows_the_state_and_its_speed() -> None:
    capture = moved_bar()
    predictor = Predictor(capture, capture.sequences[0], Settings(0.01, workers=1, dtype="float64"))
    belief = bar_belief(capture, youngs_modulus=2e4)
    moving, still = (begun(belief, [0.006], [v]) for v in (0.3, 0.0))
    shown = predictor.predict(moving, substep=1e-4)
    hold = capture.sequences[0].held[0]
    assert (
        np.linalg.norm(shown.position[0] - capture.sequences[0].markers.at - hold.position[0], axis=1).max()
        > 4e-3
    )
    # A state's rate is its change with the speeds.
    ahead = predictor.predict(begun(belief, [0.006 + 0.3e-6], [0.0]), substep=1e-4).position[0]
    rest = predictor.predict(still, substep=1e-4)
    rate = (ahead - rest.position[0]) / 1e-6
    np.testing.assert_allclose(shown.velocity[0] - rest.velocity[0], rate, atol=1e-5)
    # Without amplitudes the body begins as its hold carries it.
    plain = predictor.predict(begun(belief, [0.0], [0.0]), substep=1e-4)
    carried = capture.sequences[0].markers.at + hold.position[0]
    np.testing.assert_allclose(plain.position[0], carried, atol=1e-9)
    pose = hold.poses(np.array([0.0, 1e-5]), 60.0)[1]
    np.testing.assert_allclose(plain.velocity[0], np.tile(np.diff(pose, axis=0) / 1e-5, (4, 1)), atol=1e-3)
