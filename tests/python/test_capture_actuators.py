"""Loads whose numbers stand in a file, one a frame: forces, pressures on a patch, tendons."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from capture_example import FRAMES, Example
from mphygs.capture.actuators import Force, Pressure, Tendon
from mphygs.capture.format import load_capture, save_capture
from mphygs.fit.run import capture_digest

COURSES = {
    "force": {"force": 0.01 * np.arange(3 * FRAMES).reshape(FRAMES, 3)},
    "pressure": {"pressure": 100.0 * np.sin(np.arange(FRAMES))},
    "tension": {"tension": 0.1 * np.arange(FRAMES) ** 2.0},
}
ENTRIES = {
    "force": {"box": [[0.09, -1, -1], [1, 1, 1]], "force": "force.npz", "from": 2, "until": 9},
    "pressure": {
        "patch": {"part": "low", "box": [[-1, -1, -1], [0.05, 1, 1]]}, "pressure": "pressure.npz",
        "name": "air", "unknown": ["delay", "gain"],
    },
    "tendon": {
        "tendon": [[0.01, 0.004, 0.0], [0.05, 0.004, 0.0], [0.09, 0.004, 0.0]], "tension": "tension.npz",
        "anchor": [0.2, 0.0, 0.1], "unknown": ["gain"],
    },
}  # fmt: skip


def written(folder: Path, *kinds: str) -> Example:
    """The example capture with loads of these kinds in the place of its own."""
    example = Example(folder)
    for name, arrays in COURSES.items():
        np.savez(folder / f"{name}.npz", **arrays)
    example.sequence["loads"] = [dict(ENTRIES[kind]) for kind in kinds]
    return example


def test_each_kind_is_read_and_written(tmp_path: Path) -> None:
    example = written(tmp_path, "force", "pressure", "tendon")
    example.sequence["loads"].insert(1, {"box": [[0.09, -1, -1], [1, 1, 1]], "force": [0, 0, 1], "from": 0})
    capture = example.load()
    save_capture(capture, tmp_path / "again")
    again = load_capture(tmp_path / "again")
    assert capture_digest(again) == capture_digest(capture)
    for found in (capture, again):
        sequence = found.sequence("a")
        (constant,) = sequence.loads
        force, air, tendon = sequence.actuators
        assert np.array_equal(constant.force, [0, 0, 1])
        assert isinstance(force, Force) and isinstance(air, Pressure) and isinstance(tendon, Tendon)
        assert [a.name for a in sequence.actuators] == ["load0", "air", "load3"]
        assert np.array_equal(force.values, COURSES["force"]["force"]) and force.box[0, 0] == 0.09
        assert (force.start_frame, force.end_frame, air.start_frame, air.end_frame) == (2, 9, 0, None)
        assert (air.part, air.box[1, 0], air.unknown) == ("low", 0.05, ("gain", "delay"))
        assert np.array_equal(tendon.path, ENTRIES["tendon"]["tendon"]) and tendon.anchor[0] == 0.2
        assert tendon.unknown == ("gain",) and np.array_equal(tendon.values, COURSES["tension"]["tension"])
        assert found.sequences[1].actuators == ()


def test_a_digest_tells_of_every_number(tmp_path: Path) -> None:
    example = written(tmp_path, "tendon")
    digests = [capture_digest(example.load())]
    for change in ({"from": 1}, {"unknown": []}, {"anchor": [0.2, 0.0, 0.2]}, {"name": "pull"}):
        example.sequence["loads"][0].update(change)
        digests.append(capture_digest(example.load()))
    np.savez(tmp_path / "tension.npz", tension=1.01 * COURSES["tension"]["tension"])
    digests.append(capture_digest(example.load()))
    assert len(set(digests)) == 6


def test_a_course_is_smooth_between_frames_and_holds_outside() -> None:
    fps = 50.0
    times = np.arange(60) / fps
    force = Force(np.stack([np.sin(9 * times), np.cos(9 * times), 0 * times], 1), "f", box=np.zeros((2, 3)))
    middle = times[5:-5] + 0.3 / fps
    assert np.allclose(force.course(middle, fps)[:, 0], np.sin(9 * middle), atol=2e-6)
    assert np.allclose(force.course(middle, fps, 1)[:, 0], 9 * np.cos(9 * middle), atol=2e-3)
    outside = np.array([-1.0, times[-1] + 5.0])
    assert np.allclose(force.course(outside, fps), force.values[[0, -1]], atol=1e-14)
    assert not force.course(outside, fps, 1).any()
    alone = Tendon(np.array([2.0]), "t", path=np.zeros((2, 3)))
    assert (
        np.array_equal(alone.course(times, fps), np.full(60, 2.0)) and not alone.course(times, fps, 1).any()
    )


@pytest.mark.parametrize(
    ("kind", "change", "message"),
    [
        ("force", {"pressure": "pressure.npz"}, "loads[0]: has force and pressure; expected exactly one of"),
        ("force", {"patch": "low"}, "loads[0].patch: unknown key; expected one of box, force, name"),
        ("pressure", {"pressure": None}, "loads[0].pressure: is null; expected a text"),
        ("pressure", {"patch": "leaf"}, 'loads "air".patch: the object has no part "leaf"; expected one of'),
        ("pressure", {"patch": {}}, 'loads[0].patch: is empty; expected a part\'s name, or "part", "box"'),
        ("pressure", {"patch": {"box": [[5, 5, 5], [6, 6, 6]]}}, "no surface of the object lies in its box"),
        ("pressure", {"unknown": ["gian"]}, 'loads[0].unknown[0]: is "gian"; expected one of gain, delay'),
        (
            "pressure",
            {"name": "high"},
            'loads "high".name: is the name of a part; expected a name of its own',
        ),
        ("tendon", {"tendon": [[0.01, 0, 0]], "anchor": None}, "loads[0].anchor: is null"),
        ("tendon", {"tendon": [[0.01, 0, 0], [0.01, 0, 0]]}, "points 0 and 1 are the same"),
        ("tendon", {"tendon": [[0.01, 0, 0], [0.5, 0, 0]]}, "tendon[1]: (0.5, 0, 0) lies outside the object"),
        (
            "tendon",
            {"tension": "force.npz"},
            'force.npz: force: unknown array; expected an .npz with "tension"',
        ),
        ("tendon", {"from": 12}, "loads[0].from: is 12; expected a frame of the sequence, 0 to 11"),
        ("tendon", {"until": 0}, 'loads[0].until: is 0; expected a frame after "from", 1 to 12'),
        ("tendon", {"tension": "no.npz"}, 'loads[0].tension: "no.npz" does not exist'),
    ],
)
def test_bad_entries(tmp_path: Path, kind: str, change: dict[str, object], message: str) -> None:
    example = written(tmp_path, kind)
    example.sequence["loads"][0].update(change)
    line = example.complaint()
    assert message in line and "sequences[0]" in line or "npz" in message


def test_a_path_of_one_point_needs_an_anchor(tmp_path: Path) -> None:
    example = written(tmp_path, "tendon")
    example.sequence["loads"][0]["tendon"] = [[0.05, 0.0, 0.0]]
    assert len(example.load().sequence("a").actuators[0].path) == 1
    del example.sequence["loads"][0]["anchor"]
    assert "loads[0].tendon: has 1 point; expected two points or more, or an anchor" in example.complaint()


@pytest.mark.parametrize(
    ("kind", "array", "values", "message"),
    [
        ("tendon", "tension", np.arange(5.0), "tension: has 5 frames; expected 12, as the sequence"),
        ("force", "force", np.zeros(FRAMES), "force: has shape (12,); expected numbers of shape (T, 3)"),
        (
            "pressure",
            "pressure",
            np.where(np.arange(FRAMES) == 7, np.nan, 1.0),
            "pressure: is NaN in frame 7",
        ),
        ("pressure", "pressure", np.full(FRAMES, np.inf), "pressure: is infinite at [0]"),
        ("pressure", "pressure", np.full(FRAMES, 1e9), "pressure: is above 1e+08 Pa in frame 0"),
        ("tendon", "tension", np.linspace(1, -1, FRAMES), "is -0.0909091 N in frame 6; expected 0 or more"),
        ("tendon", "tension", np.full(FRAMES, 5e5), "times its weight; expected at most"),
        ("force", "force", np.full((FRAMES, 3), 5e5), "times its weight; expected at most"),
    ],
)
def test_bad_files(tmp_path: Path, kind: str, array: str, values: np.ndarray, message: str) -> None:
    example = written(tmp_path, kind)
    np.savez(tmp_path / f"{array}.npz", **{array: values})
    assert message in example.complaint()


def test_two_of_one_name(tmp_path: Path) -> None:
    example = written(tmp_path, "pressure", "pressure")
    assert '"air" is given twice; expected every name once' in example.complaint()
