"""Ties between the grids of parts: what they keep closed, and a bar cut in two that moves as a whole one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.scene.particles import Joint, find_joints
from mphygs.simulate.body import hold_boxes
from mphygs.simulate.discretisation import discretise
from mphygs.simulate.joint_constraints import patterns
from mphygs.simulate.modes import natural_modes
from mphygs.simulate.prediction import Predictor, Settings

SPACING = 0.006


def flat(width: float, depth: float, turn: np.ndarray | None = None) -> Joint:
    """A rectangle in the plane z = 0, or turned."""
    x, y = ((np.arange(20) + 0.5) / 20 - 0.5 for _ in range(2))
    points = np.stack([np.repeat(x * width, 20), np.tile(y * depth, 20), np.zeros(400)], axis=1)
    turn = np.eye(3) if turn is None else turn
    area = np.full(400, width * depth / 400)
    return Joint((0, 1), points @ turn.T, area, np.tile(turn[:, 2], (400, 1)))


@pytest.mark.parametrize("size", [0.2, 1.0, 3.0, 6.0])
def test_patterns_are_orthonormal_and_carry_force_and_torque(size: float) -> None:
    joint = flat(size * SPACING, size * SPACING)
    weight = joint.area / joint.area.sum()
    found = patterns(joint, SPACING)
    np.testing.assert_allclose((weight[:, None] * found).T @ found, np.eye(found.shape[1]), atol=1e-9)
    for values in (np.ones(400), joint.points[:, 0], joint.points[:, 1]):
        left = values - found @ (found.T @ (weight * values))
        assert np.abs(left).max() < 1e-9 * np.abs(values).max()
    assert found.shape[1] <= 5 if size < 1.5 else found.shape[1] > 5


def test_a_thin_joint_keeps_its_torque_and_a_flat_one_has_no_height() -> None:
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    joint = flat(0.01, 1e-4, turn)
    found = patterns(joint, SPACING)
    weight = joint.area / joint.area.sum()
    across = joint.points @ turn[:, 1]
    assert np.abs(across - found @ (found.T @ (weight * across))).max() < 1e-9 * np.abs(across).max()
    height = np.random.default_rng(1).normal(size=400) * 1e-4
    raised = Joint(joint.parts, joint.points + height[:, None] * turn[:, 2], joint.area, joint.normal)
    found = patterns(raised, SPACING)
    assert np.linalg.norm(height - found @ (found.T @ (weight * height))) > 0.9 * np.linalg.norm(height)


def test_a_long_thin_joint_is_bent_by_no_part_of_it() -> None:
    joint = flat(0.03, 2e-4)
    weight = joint.area / joint.area.sum()
    found = patterns(joint, SPACING)
    # The turn about the joint's line where one of its ends turns and the other does not.
    turn = np.maximum(joint.points[:, 0], 0.0) * joint.points[:, 1]
    left = turn - found @ (found.T @ (weight * turn))
    assert np.linalg.norm(left) < 0.2 * np.linalg.norm(turn)


def test_rows_vanish_for_every_linear_displacement() -> None:
    capture = bar_capture(lengths=(0.034, 0.029))
    body = discretise(capture, hold_boxes(capture.sequences[0]), SPACING)
    g = body.geometry
    model = Predictor(capture, capture.sequences[0], Settings(SPACING, workers=1)).model(
        (), np.zeros((0, 3)), "neo-hookean"
    )
    place = {tuple(i): x for i, x in zip(model.node_index, model.node_positions, strict=True)}
    slope = np.random.default_rng(2).normal(size=(3, 3))
    jump = {}
    ties = np.flatnonzero(g["row_hold"] < 0)
    assert len(ties) >= 4
    for row in ties:
        span = slice(g["row_begin"][row], g["row_begin"][row + 1])
        at = np.array([place[tuple(i)] for i in g["row_node"][span]])
        np.testing.assert_allclose(g["row_weight"][span] @ (at @ slope + 1.0), 0.0, atol=1e-15)
        first = g["row_node"][span][:, 0] < g["grid_width"]
        jump[row] = g["row_weight"][span][first].sum()
    # The first row of the joint is the mean of the jump: it opens where one side moves.
    assert abs(jump[ties[0]]) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("cut", [0.03, 0.0337])
def test_a_bar_in_two_parts_moves_as_a_whole_one(cut: float) -> None:
    at = np.array([[0.06, 0.0, 0.0], [0.06, 0.012, 0.0], [0.045, 0.0, 0.012], [0.02, 0.012, 0.006]])
    times = np.arange(12) / 50.0
    angle = 0.25 * np.sin(2 * np.pi * 2.0 * times)
    frequency, moved = [], []
    for lengths in ((0.06,), (cut, 0.06 - cut)):
        capture = bar_capture(
            lengths=lengths, side=0.012, gravity=np.zeros(3), markers_at=at, frames=12,
            motion=np.zeros((12, 3)),
        )  # fmt: skip
        (recording,) = capture.sequences
        # The hold turns about the bar's axis: torque goes through the joint.
        turn = np.stack([np.cos(angle / 2), np.sin(angle / 2), 0 * angle, 0 * angle], axis=1)
        shift = np.array([np.zeros(12), 0.006 * (1 - np.cos(angle)) + 0.006 * np.sin(angle),
                          0.006 * (1 - np.cos(angle)) - 0.006 * np.sin(angle)]).T  # fmt: skip
        hold = replace(recording.held[0], position=shift, quaternion=turn)
        recording = replace(recording, held=(hold,))
        belief = bar_belief(
            capture, youngs_modulus=(5e4,) * len(lengths), density=(1000.0,) * len(lengths), prestress="off"
        )
        predictor = Predictor(capture, recording, Settings(SPACING, dtype="float64", workers=1))
        frequency.append(np.sqrt(natural_modes(predictor, belief, 4).squared[:2]))
        moved.append(predictor.predict(belief).position - at)
    np.testing.assert_allclose(frequency[1], frequency[0], rtol=1e-3)
    assert np.abs(moved[0]).max() > 2e-3
    # What a square bar's section does out of its plane under torque is finer than the patterns.
    np.testing.assert_allclose(moved[1], moved[0], atol=0.02 * np.abs(moved[0]).max())


def test_one_part_has_one_grid_and_no_ties() -> None:
    capture = bar_capture(lengths=(0.03,))
    body = discretise(capture, hold_boxes(capture.sequences[0]), SPACING)
    assert not (body.geometry["row_hold"] < 0).any(), "one part has nothing to be tied to"
    assert body.geometry["grid_width"] == 0
    assert find_joints(capture.parts, spacing=SPACING) == []


def test_a_part_that_hangs_on_nothing_is_refused() -> None:
    capture = bar_capture(lengths=(0.034, 0.029, 0.02))
    apart = replace(capture.parts[1], vertices=capture.parts[1].vertices + [0.0, 0.05, 0.0])
    loose = replace(capture, parts=(capture.parts[0], apart, capture.parts[2]))
    with pytest.raises(ValueError, match=r"^part 'part1' hangs on nothing: it is 0\.03 m from .*, expected"):
        discretise(loose, hold_boxes(capture.sequences[0]), SPACING)
    # The third one touched only the second; where nothing is held all of it flies.
    behind = replace(capture, parts=(capture.parts[0], capture.parts[2]))
    with pytest.raises(ValueError, match=r"^part 'part2' hangs on nothing: it is 0\.029 m from"):
        discretise(behind, hold_boxes(capture.sequences[0]), SPACING)
    discretise(loose, np.empty((0, 2, 3)), SPACING)
