"""Held boxes and their motion, known loads."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture_example import FRAMES, NAMES, Example, write_c3d
from mphygs.capture.format import load_capture, save_capture
from mphygs.capture.holds import Hold
from mphygs.capture.rotation import matrix_from_quaternion, quaternion_from_rotation_vector

Change = Callable[[np.ndarray], np.ndarray]
BOX = np.array([[0.0, 0, 0], [1, 1, 1]])


def moving(frames: int = 40, fps: float = 30.0) -> tuple[Hold, np.ndarray]:
    """A smooth motion sampled at the frames, with quaternions whose sign jumps."""
    time = np.arange(frames) / fps
    quaternion = quaternion_from_rotation_vector(np.sin(5 * time)[:, None] * [[0.3, 0.2, -0.5]])
    quaternion[1::3] *= -1
    return Hold(
        box=BOX, position=np.sin(6 * time)[:, None] * [[0.01, 0.02, 0.0]], quaternion=quaternion
    ), time


def test_a_fixed_hold_stays() -> None:
    hold = Hold(box=BOX)
    rotation, position = hold.poses(np.array([-1.0, 0.0, 5.0]), 30.0)
    assert hold.is_fixed and np.array_equal(rotation, np.tile(np.eye(3), (3, 1, 1))) and not position.any()


def test_poses_pass_through_the_frames() -> None:
    hold, time = moving()
    rotation, position = hold.poses(time, 30.0)
    assert not hold.is_fixed
    assert np.allclose(position, hold.position, atol=1e-15)
    assert np.allclose(rotation, matrix_from_quaternion(hold.quaternion), atol=1e-14)


def test_poses_between_frames_are_smooth_not_linear() -> None:
    hold, time = moving()
    middle = time[5:-5] + 0.5 / 30
    rotation, position = hold.poses(middle, 30.0)
    exact = np.sin(6 * middle)[:, None] * [[0.01, 0.02, 0.0]]
    linear = (hold.position[5:-5] + hold.position[6:-4]) / 2
    assert np.abs(position - exact).max() < 1e-2 * np.abs(linear - exact).max()
    turned = quaternion_from_rotation_vector(np.sin(5 * middle)[:, None] * [[0.3, 0.2, -0.5]])
    assert np.allclose(rotation, matrix_from_quaternion(turned), atol=1e-4)
    assert np.allclose(rotation @ rotation.transpose(0, 2, 1), np.eye(3), atol=1e-14)


def test_poses_outside_the_frames_keep_the_first_and_go_on_for_a_frame_after_the_last() -> None:
    hold, time = moving()
    rotation, position = hold.poses(np.array([-3.0]), 30.0)
    assert np.allclose(position, hold.position[:1], atol=1e-15)
    assert np.allclose(rotation, matrix_from_quaternion(hold.quaternion[:1]))
    ends = time[-1] + np.array([0.0, 0.4, 1.0, 1.2, 3000.0]) / 30
    rotation, position = hold.poses(ends, 30.0)
    speed = 6 * np.cos(6 * time[-1]) * np.array([0.01, 0.02, 0.0])
    after = hold.position[-1] + (np.array([0.0, 0.4, 1.0, 1.0, 1.0]) / 30)[:, None] * speed
    assert np.allclose(position, after, atol=1e-5) and np.allclose(position[2:], position[2], atol=1e-15)
    assert np.linalg.norm(position[2] - position[0]) > 1e-4
    assert np.allclose(rotation @ rotation.transpose(0, 2, 1), np.eye(3), atol=1e-14)
    assert np.allclose(rotation[2:], rotation[2])


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_poses_of_very_short_motions(frames: int) -> None:
    hold, time = moving(frames)
    _, position = hold.poses(time, 30.0)
    assert np.allclose(position, hold.position, atol=1e-15)


def test_example_hold_and_load_are_read(tmp_path: Path) -> None:
    example = Example(tmp_path)
    sequence = example.load().sequence("a")
    (hold,), (load,) = sequence.held, sequence.loads
    assert np.array_equal(hold.position, example.motion["position"])
    assert np.allclose(hold.quaternion, example.motion["quaternion"], atol=1e-15)
    assert np.array_equal(load.force, [0, 0, -0.5]) and load.start_frame == 3
    assert np.array_equal(load.box, [[0.09, -1, -1], [1, 1, 1]])


def test_a_load_that_ends_and_a_stated_start_are_read_and_written(tmp_path: Path) -> None:
    example = Example(tmp_path)
    example.sequence["loads"][0]["until"] = FRAMES
    del example.sequence["release"]
    for start in ("measured", "rest"):
        example.sequence["start"] = start
        save_capture(example.load(), tmp_path / start)
        again = load_capture(tmp_path / start)
        assert [s.start for s in again.sequences] == [start, None]
        assert again.sequence("a").loads[0].end_frame == FRAMES


def test_bad_starts(tmp_path: Path) -> None:
    example = Example(tmp_path)
    example.sequence["start"] = "moving"
    assert 'sequences[0].start: is "moving"; expected "rest" or "measured"' in example.complaint()
    example.sequence["start"] = "measured"
    assert 'sequences[0].start: is "measured" beside a release; expected no release' in example.complaint()
    del example.sequence["release"]
    write_c3d(tmp_path / "m.c3d", example.tracks, labels=NAMES)
    example.sequence["markers"]["file"] = "m.c3d"
    assert "m.c3d is told in the object frame by its rest, which the sequence does not" in example.complaint()


def test_nearly_unit_quaternions_are_normalised(tmp_path: Path) -> None:
    example = Example(tmp_path)
    motion = example.motion | {"quaternion": example.motion["quaternion"] * 1.0005}
    np.savez(tmp_path / "hold.npz", **motion)
    quaternion = example.load().sequence("a").held[0].quaternion
    assert np.allclose(np.linalg.norm(quaternion, axis=1), 1.0, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("quaternion", lambda q: q * 1.01, "quaternion: has length 1.01 in frame"),
        (
            "quaternion",
            lambda q: q[:-1],
            f"quaternion: has {FRAMES - 1} frames; expected {FRAMES}, as the sequence",
        ),
        ("position", lambda p: p[1:], f"position: has {FRAMES - 1} frames; expected {FRAMES}"),
        ("quaternion", lambda q: q[:, :3], "quaternion: has shape (12, 3); expected numbers of shape (T, 4)"),
        (
            "position",
            lambda p: np.where(np.arange(FRAMES)[:, None] == 7, np.nan, p),
            "position: is NaN in frame 7",
        ),
        ("position", lambda p: p * np.nan, "position: is NaN in frame 0"),
        ("position", lambda p: p + np.inf, "position: is infinite at [0, 0]"),
        ("position", lambda p: p * 1e6, "moves the held points"),
    ],
)
def test_bad_motions(tmp_path: Path, name: str, change: Change, message: str) -> None:
    example = Example(tmp_path)
    np.savez(tmp_path / "hold.npz", **(example.motion | {name: change(example.motion[name])}))
    line = example.complaint()
    assert message in line
    assert "hold.npz" in line or "sequences[0].held[0].motion" in line


def test_motion_without_quaternions(tmp_path: Path) -> None:
    example = Example(tmp_path)
    np.savez(tmp_path / "hold.npz", position=example.motion["position"])
    assert 'hold.npz: array "quaternion" is missing' in example.complaint()


@pytest.mark.parametrize(
    ("key", "change", "message"),
    [
        (
            "held",
            {"box": [[0, 0, 0], [1, -1, 1]]},
            "held[0].box: lower corner 0 above upper corner -1 along y",
        ),
        ("held", {"box": [[0, 0, 0]]}, "held[0].box: has shape (1, 3); expected an array of shape (2, 3)"),
        ("held", {"box": [[1, 1, 1], [2, 2, 2]]}, "held[0].box: no material of the object lies in it"),
        ("held", {"box": [[-1, -1, -1], [1, 1, 1]]}, "held[0].box: holds the whole object"),
        ("held", {"motion": "fix"}, 'held[0].motion: "fix" does not exist'),
        ("held", {"motion": "../hold.npz"}, 'held[0].motion: "../hold.npz" leads out of the folder'),
        ("held", {"moton": "fixed"}, 'held[0].moton: unknown key (did you mean "motion"?)'),
        ("loads", {"box": [[1, 1, 1], [2, 2, 2]]}, "loads[0].box: no material of the object lies in it"),
        ("loads", {"force": [1, 2]}, "loads[0].force: has shape (2,); expected an array of shape (3,)"),
        ("loads", {"from": 12}, "loads[0].from: is 12; expected a frame of the sequence, 0 to 11"),
        ("loads", {"from": -1}, "loads[0].from: is -1"),
        ("loads", {"from": 1.5}, "loads[0].from: is 1.5; expected an integer"),
        ("loads", {"start": 1}, "loads[0].start: unknown key"),
        ("loads", {"until": 3}, 'loads[0].until: is 3; expected a frame after "from", 4 to 12'),
        ("loads", {"until": 13}, "loads[0].until: is 13"),
        ("loads", {"until": 5.5}, "loads[0].until: is 5.5; expected an integer"),
    ],
)
def test_bad_entries(tmp_path: Path, key: str, change: dict[str, object], message: str) -> None:
    example = Example(tmp_path)
    example.sequence[key][0].update(change)
    assert f"capture.json: sequences[0].{message}" in example.complaint()


def test_a_box_inside_the_material_without_any_vertex_holds_it(tmp_path: Path) -> None:
    example = Example(tmp_path)
    example.sequence["held"][0]["box"] = [[0.01, -0.002, -0.002], [0.012, 0.002, 0.002]]
    assert len(example.load().sequence("a").held) == 1


@pytest.mark.parametrize("degrees", [100.0, 180.0, 175.0])
def test_poses_that_turn_too_far_in_a_frame(degrees: float, tmp_path: Path) -> None:
    example = Example(tmp_path)
    angle = np.radians(degrees) * np.arange(FRAMES)[:, None] * [[0.0, 1.0, 0.0]]
    motion = {"position": np.zeros((FRAMES, 3)), "quaternion": quaternion_from_rotation_vector(angle)}
    np.savez(tmp_path / "hold.npz", **motion)
    assert f"quaternion: turns by {degrees:.0f} degrees to frame" in example.complaint()
    motion["quaternion"] = quaternion_from_rotation_vector(0.4 * angle)
    motion["quaternion"][::2] *= -1
    np.savez(tmp_path / "hold.npz", **motion)
    assert not example.load().sequences[0].held[0].is_fixed
