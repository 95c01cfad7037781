"""Movements of the hold are what they say, with continuous acceleration."""

import numpy as np
import pytest

from mphygs.capture.motions import HoldMovement, hold_poses, ramp
from mphygs.capture.rotation import matrix_from_quaternion


def test_ramp_has_no_jump_in_two_derivatives() -> None:
    s = np.linspace(-0.2, 1.2, 140001)
    step = s[1] - s[0]
    first = np.gradient(ramp(s), step)
    second = np.gradient(first, step)
    assert ramp(np.array([0.0, 0.5, 1.0])) == pytest.approx([0.0, 0.5, 1.0])
    assert np.abs(np.diff(first)).max() < 10.0 * step
    assert np.abs(np.diff(second)).max() < 100.0 * step


def test_movements_add_up_and_turn_about_the_pivot() -> None:
    pivot = np.array([0.1, 0.0, 0.02])
    shift = HoldMovement("shift", 0.1, 0.4, by=(0.0, 0.02, 0.01))
    turn = HoldMovement("turn", 0.1, 0.4, axis=(0.0, 0.0, 2.0), degrees=90.0)
    times = np.array([0.0, 0.1, 0.4, 1.0])
    position, quaternion = hold_poses((shift, turn), times, pivot)
    moved = matrix_from_quaternion(quaternion) @ pivot + position
    assert moved[:2] == pytest.approx(np.tile(pivot, (2, 1)))
    assert moved[2:] == pytest.approx(np.tile(pivot + [0.0, 0.02, 0.01], (2, 1)))
    along = matrix_from_quaternion(quaternion[-1]) @ np.array([1.0, 0.0, 0.0])
    assert along == pytest.approx([0.0, 1.0, 0.0], abs=1e-12)


def test_a_shake_swings_at_its_frequency_and_ends_where_it_began() -> None:
    shake = HoldMovement("shake", 0.5, 2.5, by=(0.01, 0.0, 0.0), frequency=4.0, ramp=0.2)
    times = np.linspace(0.0, 3.0, 3001)
    x = hold_poses((shake,), times, np.zeros(3))[0][:, 0]
    assert np.abs(x[times <= 0.5]).max() == 0.0 and np.abs(x[times >= 2.5]).max() == 0.0
    assert x.max() == pytest.approx(0.01, rel=1e-3)
    inner = x[(times > 0.71) & (times < 2.29)]
    crossings = np.count_nonzero(np.diff(np.sign(inner)) != 0)
    assert crossings == pytest.approx(2 * 4.0 * (2.29 - 0.71), abs=1.0)


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"kind": "jump", "start": 0.0, "stop": 1.0}, "expected one of shake"),
        ({"kind": "turn", "start": 1.0, "stop": 1.0}, "before its stop"),
        ({"kind": "shake", "start": 0.0, "stop": 0.3, "ramp": 0.2}, "at most half"),
    ],
)
def test_impossible_movements_are_refused(values, said) -> None:
    with pytest.raises(ValueError, match=said):
        HoldMovement(**values)
