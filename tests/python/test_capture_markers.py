"""Markers from .npz and .c3d, their names, their frame, their faults."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from capture_example import AT, FRAMES, NAMES, Example, shared, write_c3d
from mphygs.capture.format import Markers, load_capture
from mphygs.capture.markers import resting_position
from mphygs.capture.rotation import matrix_from_rotation_vector

Change = Callable[[np.ndarray], np.ndarray]
TURN = matrix_from_rotation_vector(np.array([0.4, -1.2, 2.0]))


def markers(example: Example) -> Markers:
    found = example.load().sequence("a").markers
    assert found is not None
    return found


def use_c3d(example: Example, position: np.ndarray, **options: object) -> None:
    """Give the example its markers as a .c3d instead."""
    write_c3d(example.folder / "m.c3d", position, **({"labels": NAMES} | options))
    example.sequence["markers"]["file"] = "m.c3d"


def test_npz_is_read_as_it_stands(tmp_path: Path) -> None:
    example = Example(tmp_path)
    found = markers(example)
    assert np.array_equal(found.position, example.tracks, equal_nan=True) and np.isnan(found.position).any()
    assert np.array_equal(found.at, AT) and found.sigma == 1e-4 and found.names == ()
    example.sequence["markers"]["names"] = NAMES
    assert markers(example).names == tuple(NAMES)


def test_resting_position_ignores_outliers_gaps_and_motion() -> None:
    position = np.tile(AT, (FRAMES, 1, 1))
    position[6:] += 1.0
    position[2, 0] += 5.0
    position[:3, 1] = np.nan
    position[:6, 2] = np.nan
    rest = resting_position(position, 6)
    assert np.array_equal(rest[[0, 1, 3]], AT[[0, 1, 3]]) and np.isnan(rest[2]).all()
    position[4:] += 1.0
    assert np.array_equal(resting_position(position, None)[[0, 3]], AT[[0, 3]])
    assert np.array_equal(resting_position(position, 0)[[0, 3]], AT[[0, 3]])


def test_c3d_is_brought_into_the_object_frame(tmp_path: Path) -> None:
    example = Example(tmp_path)
    use_c3d(example, example.tracks @ TURN.T + [1.0, 2.0, 3.0])
    found = markers(example)
    assert np.nanmax(np.abs(found.position - example.tracks)) < 4e-4
    assert np.abs(found.at_rest(6) - AT).max() < 2e-4
    assert np.array_equal(np.isnan(found.position), np.isnan(example.tracks))
    assert found.names == tuple(NAMES)


def test_c3d_alignment_uses_the_resting_frames_only(tmp_path: Path) -> None:
    example = Example(tmp_path)
    lost = AT + np.zeros((FRAMES, 1, 1))
    lost[6:] = lost[6:] @ TURN + 0.3
    use_c3d(example, lost @ TURN.T)
    assert np.abs(markers(example).position[:6] - AT).max() < 1e-6
    example.sequence["release"] = 1
    lost[1:6] += 0.2
    use_c3d(example, lost)
    assert np.abs(markers(example).position[0] - AT).max() < 1e-6


def test_c3d_units_names_and_length(tmp_path: Path) -> None:
    example = Example(tmp_path)
    longer = np.concatenate([example.tracks, example.tracks[:3]])
    extra = np.concatenate([longer[:, ::-1], longer[:, :1] + 5], axis=1)
    use_c3d(example, 1e3 * extra, labels=[*NAMES[::-1], "stray"], unit="mm")
    example.sequence["markers"]["names"] = NAMES
    found = markers(example)
    assert found.position.shape == (FRAMES, 4, 3) and found.names == tuple(NAMES)
    assert np.nanmax(np.abs(found.position - example.tracks)) < 4e-4


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"rate": 100.0}, "m.c3d: POINT:RATE: is 100 Hz; expected the fps of the sequence, 50"),
        ({"unit": "furlong"}, 'm.c3d: POINT:UNITS: is "furlong"; expected one of m, dm, cm, mm'),
        ({"unit": ""}, 'm.c3d: POINT:UNITS: is ""'),
        (
            {"labels": ["a", "b", "c", "d"], "names": NAMES},
            'markers.names: no point is labelled "tip"; expected one of a, b',
        ),
        ({"keep": (slice(0, 5), slice(None))}, f"m.c3d: POINT: has 5 frames; expected at least {FRAMES}"),
        (
            {"keep": (slice(None), slice(0, 3)), "labels": NAMES[:3]},
            "has 3 markers; expected 4, one for each row of at",
        ),
        (
            {"keep": (slice(None), [0, 0, 0, 0])},
            "cannot be aligned to the object at rest (the points lie on one line)",
        ),
    ],
)
def test_bad_c3d(tmp_path: Path, options: dict, message: str) -> None:
    example = Example(tmp_path)
    options = dict(options)
    if names := options.pop("names", None):
        example.sequence["markers"]["names"] = names
    use_c3d(example, example.tracks[options.pop("keep", slice(None))], **options)
    assert message in example.complaint()


def test_c3d_that_sees_too_few_markers_at_rest(tmp_path: Path) -> None:
    example = Example(tmp_path)
    example.tracks[:6, :2] = np.nan
    use_c3d(example, example.tracks)
    line = example.complaint()
    assert "m.c3d: position: cannot be aligned" in line and "three markers seen at rest" in line


def test_c3d_point_of_negative_residual_was_not_seen(tmp_path: Path) -> None:
    example = Example(tmp_path)
    use_c3d(example, example.tracks)
    content = (tmp_path / "m.c3d").read_bytes()
    first = content.index(example.tracks[0, 0].astype("<f4").tobytes()) + 12
    (tmp_path / "m.c3d").write_bytes(content[:first] + np.float32(-1).tobytes() + content[first + 4 :])
    missing = np.isnan(markers(example).position).all(axis=2)
    assert np.argwhere(missing).tolist() == [[0, 0], [4, 1]]


def test_damaged_c3d(tmp_path: Path) -> None:
    example = Example(tmp_path)
    use_c3d(example, np.tile(example.tracks, (20, 1, 1)))
    path = tmp_path / "m.c3d"
    whole = path.read_bytes()
    for content in (b"", whole[:100], whole[:512], whole[:-900], b"hello" * 900):
        path.write_bytes(content)
        line = example.complaint()
        assert str(path) in line and "truncated" in line


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda p: p[:-2], f"markers.npz: position: has 10 frames; expected {FRAMES}, as the sequence"),
        (lambda p: np.concatenate([p, p]), f"markers.npz: position: has 24 frames; expected {FRAMES}"),
        (lambda p: p[:, :3], "markers.npz: position: has 3 markers; expected 4, one for each row of at"),
        (lambda p: p * np.nan, "markers.npz: position: is NaN everywhere; expected measured positions"),
        (lambda p: 0.0 * np.nan_to_num(p), "markers.npz: position: is zero wherever it is measured"),
        (lambda p: np.nan_to_num(p).astype(int), "markers.npz: position: is zero wherever it is measured"),
        (
            lambda p: np.where(np.arange(3) == 1, np.nan, p),
            "markers.npz: position: has no place with all of x, y and z",
        ),
        (
            lambda p: p[..., 0],
            "markers.npz: position: has shape (12, 4); expected numbers of shape (T, M, 3)",
        ),
        (lambda p: p * 1000, "markers.at[0]: marker 0 is measured 100 m from there at rest"),
        (
            lambda p: p + [[0, 0, 0], [0, 0, 0], [0, 0, 1.0], [0, 0, 0]],
            "markers.at[2]: marker 2 is measured 1 m",
        ),
        (
            lambda p: np.where(np.arange(FRAMES)[:, None, None] < 8, np.nan, p),
            "sequences[0].fit: no marker is measured in frames 0 to 8",
        ),
    ],
)
def test_bad_tracks(tmp_path: Path, change: Change, message: str) -> None:
    example = Example(tmp_path)
    np.savez(tmp_path / "markers.npz", position=change(example.tracks))
    assert message in example.complaint()


def test_one_marker_never_seen_is_allowed(tmp_path: Path) -> None:
    example = Example(tmp_path)
    example.tracks[:, 2] = np.nan
    np.savez(tmp_path / "markers.npz", position=example.tracks)
    assert np.isnan(markers(example).position[:, 2]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sigma": 0}, "markers.sigma: is 0; expected a standard deviation above zero"),
        ({"sigma": -1e-4}, "markers.sigma: is -0.0001"),
        ({"sigma": 0.2}, "markers.sigma: is 0.2 m, larger than the object; expected far below 0.104 m"),
        ({"sgima": 1}, 'markers.sgima: unknown key (did you mean "sigma"?)'),
        ({"at": (1000 * AT).tolist()}, "markers.at[0]: lies 100 m from the object"),
        ({"at": (AT + [0, 0.2, 0]).tolist()}, "markers.at[1]: lies 0.2 m from the object"),
        ({"at": (AT / 1000).tolist()}, "markers.at: markers spread over"),
        ({"at": AT[:3].tolist()}, "has 4 markers; expected 3"),
        ({"at": AT[:, :2].tolist()}, "markers.at[0]: has shape (2,); expected an array of shape (N, 3)"),
        ({"names": ["a"]}, "markers.names: has 1 names; expected 4, one for each row of at"),
        ({"names": ["a", "b", "a", "c"]}, 'markers.names: name "a" is given twice'),
        ({"file": "capture.json"}, 'markers.file: is "capture.json"; expected an .npz or a .c3d file'),
        ({"file": "none.npz"}, 'markers.file: "none.npz" does not exist'),
    ],
)
def test_bad_entries(tmp_path: Path, change: dict[str, object], message: str) -> None:
    example = Example(tmp_path)
    example.sequence["markers"].update(change)
    assert message in example.complaint()


def test_a_hold_that_starts_elsewhere_carries_the_markers_there(tmp_path: Path) -> None:
    example = Example(tmp_path)
    motion = example.motion | {"position": example.motion["position"] + [0, 0, 2.0]}
    np.savez(tmp_path / "markers.npz", position=example.tracks + [0, 0, 2.0])
    assert "markers.at[" in example.complaint()
    np.savez(tmp_path / "hold.npz", **motion)
    assert example.load().sequence("a").markers is not None


@pytest.mark.parametrize("name", ["gravity-a", "load101-a"])
def test_silicone_beam_base_markers_stay_at_their_places(name: str) -> None:
    sequence = load_capture(shared("silicone-beam")).sequence(name)
    assert sequence.markers is not None and sequence.release is not None
    base = [index for index, label in enumerate(sequence.markers.names) if label.startswith("Base")]
    assert len(base) == 3
    before = sequence.markers.position[: sequence.release, base] - sequence.markers.at[base]
    assert np.linalg.norm(before, axis=-1).max() < 1e-3
    tip = np.delete(sequence.markers.position, base, axis=1)
    fall = tip[sequence.release :, :, 2].min() - tip[: sequence.release, :, 2].min()
    assert -0.1 < fall < -0.005


# ---- files as people have them ----------------------------------------------------------------
def test_zeros_for_gaps_are_noticed_and_said(tmp_path: Path) -> None:
    example = Example(tmp_path)
    track = example.tracks.copy()
    track[[2, 7, 8], 0] = 0.0
    track[9:, 3] = 0.0
    np.savez(tmp_path / "markers.npz", position=track)
    markers = example.load().sequences[0].markers
    assert np.isnan(markers.position[[2, 7, 8], 0]).all() and np.isnan(markers.position[9:, 3]).all()
    assert np.isfinite(markers.position[:9, 3]).all()
    assert [finding.text for finding in markers.findings] == [
        "6 marker positions of exactly 0 0 0 are taken as not measured (zero_is_missing)",
    ]
    example.sequence["markers"]["zero_is_missing"] = False
    assert (
        "marker" in example.complaint()
        if np.linalg.norm(AT[0]) > 0.5
        else not example.load().sequences[0].markers.findings
    )
    example.sequence["markers"]["zero_is_missing"] = "yes"
    assert 'zero_is_missing: is "yes"; expected true or false' in example.complaint()


def test_a_marker_that_is_at_zero_is_there(tmp_path: Path) -> None:
    example = Example(tmp_path)
    at = AT.copy()
    at[2] = 0.0
    track = example.tracks - AT + at
    track[:6, 2] = 0.0
    np.savez(tmp_path / "markers.npz", position=track)
    example.sequence["markers"]["at"] = at.tolist()
    markers = example.load().sequences[0].markers
    assert markers.findings == () and (markers.position[:6, 2] == 0.0).all()
    example.sequence["markers"]["zero_is_missing"] = True
    assert np.isnan(example.load().sequences[0].markers.position[:6, 2]).all()


def test_zeros_of_a_c3d_are_those_of_its_own_frame(tmp_path: Path) -> None:
    example = Example(tmp_path)
    track = example.tracks + [2.0, 1.0, 0.5]
    track[7, 1] = 0.0
    write_c3d(tmp_path / "markers.c3d", track, labels=NAMES)
    example.sequence["markers"]["file"] = "markers.c3d"
    markers = example.load().sequences[0].markers
    assert np.isnan(markers.position[7, 1]).all() and len(markers.findings) == 1
    assert np.nanmax(np.abs(markers.position[0] - AT)) < 1e-3


def test_a_c3d_that_begins_with_unseen_markers(tmp_path: Path) -> None:
    example = Example(tmp_path)
    del example.sequence["release"]
    example.sequence["loads"] = []
    track = example.tracks.copy()
    track[:5] = np.nan
    track[6:] = track[5]
    write_c3d(tmp_path / "markers.c3d", track + [1.0, 0, 0], labels=NAMES)
    example.sequence["markers"]["file"] = "markers.c3d"
    assert np.nanmax(np.abs(example.load().sequences[0].markers.position[5:] - AT)) < 1e-3


@pytest.mark.parametrize("suffix", ["npz", "c3d"])
def test_a_sequence_may_begin_in_the_midst_of_its_file(suffix: str, tmp_path: Path) -> None:
    example = Example(tmp_path)
    longer = np.concatenate([np.tile(AT, (3, 1, 1)) + 1e-4, example.tracks, np.tile(AT, (2, 1, 1))])
    if suffix == "npz":
        np.savez(tmp_path / "markers.npz", position=longer)
    else:
        write_c3d(tmp_path / "markers.c3d", longer, labels=NAMES)
        example.sequence["markers"]["file"] = "markers.c3d"
    example.sequence["first_frame"] = 3
    found = example.load().sequences[0].markers.position
    assert found.shape == example.tracks.shape
    assert np.nanmax(np.abs(found - example.tracks)) < (1e-12 if suffix == "npz" else 3e-4)
    example.sequence["first_frame"] = 6
    assert "has 17 frames; expected at least 18" in example.complaint()
    for wrong in (-1, 1.5, "3", 10**12):
        example.sequence["first_frame"] = wrong
        assert "first_frame: is" in example.complaint()


def test_a_c3d_without_points(tmp_path: Path) -> None:
    example = Example(tmp_path)
    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [50.0]
    content["data"]["points"] = np.ones((4, 0, FRAMES))
    content.write(str(tmp_path / "markers.c3d"))
    example.sequence["markers"]["file"] = "markers.c3d"
    assert "markers.c3d" in example.complaint()


@pytest.mark.parametrize("far", [1e3, 1e6, 1e150, 1e300, -1.7e308])
@pytest.mark.parametrize("frame", [0, 7, FRAMES - 1])
def test_places_that_no_marker_has_are_refused_in_any_frame(far: float, frame: int, tmp_path: Path) -> None:
    example = Example(tmp_path)
    track = example.tracks.copy()
    track[frame, 2, 1] = far
    np.savez(tmp_path / "markers.npz", position=track)
    line = example.complaint()
    assert f"marker 2 is measured {abs(far):.3g} m from the object in frame {frame}" in line


def test_what_is_held_is_not_stretched_beyond_measure(tmp_path: Path) -> None:
    example = Example(tmp_path)
    track = example.tracks.copy()
    track[8:, :, 2] -= np.arange(FRAMES - 8)[:, None] * 0.3
    np.savez(tmp_path / "markers.npz", position=track)
    assert (
        "times the size of the object; expected within 5 times its size (is it still held"
        in example.complaint()
    )
    example.sequence["held"] = []
    assert example.load().sequences[0].markers is not None
