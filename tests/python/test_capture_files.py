"""Paths stay in the folder; arrays are read without pickle."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mphygs.capture.document import Entry
from mphygs.capture.errors import CaptureError
from mphygs.capture.files import file_inside, path_inside, read_arrays, views_inside


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    inside = tmp_path / "capture"
    (inside / "sub").mkdir(parents=True)
    (inside / "sub" / "a.txt").write_text("a")
    (tmp_path / "secret.txt").write_text("s")
    (tmp_path / "capture-other").mkdir()
    (inside / "link.txt").symlink_to(tmp_path / "secret.txt")
    (inside / "up").symlink_to(tmp_path)
    (inside / "fine.txt").symlink_to(inside / "sub" / "a.txt")
    (inside / "loop").symlink_to(inside / "loop")
    return inside


def entry(text: object) -> Entry:
    return Entry(text, "f.json", "views")


def test_paths_inside_are_found(folder: Path) -> None:
    for text in ("sub/a.txt", "./sub/../sub/a.txt", "fine.txt"):
        assert file_inside(folder, entry(text)).read_text() == "a"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("../secret.txt", "leads out of the folder"),
        ("sub/../../secret.txt", "leads out of the folder"),
        ("../capture-other", "leads out of the folder"),
        ("link.txt", "leads out of the folder"),
        ("up/secret.txt", "leads out of the folder"),
        ("/etc/hostname", 'is "/etc/hostname"'),
        ("C:\\data.ply", "expected a path relative"),
        ("\\\\host\\data.ply", "expected a path relative"),
        ("sub/a\0.txt", "expected a path relative"),
        ("none.txt", "does not exist"),
        ("loop", "expected a"),
        ("", "expected a text"),
        (7, "is 7; expected a text"),
        ("x" * 5000, "expected a"),
    ],
)
def test_paths_outside_or_absent_are_refused(folder: Path, text: object, message: str) -> None:
    with pytest.raises(CaptureError) as caught:
        path_inside(folder, entry(text))
    assert message in str(caught.value) and str(caught.value).startswith("f.json: views: ")


def test_kind_of_path(folder: Path) -> None:
    with pytest.raises(CaptureError, match="is not a file; expected a file"):
        file_inside(folder, entry("sub"))
    with pytest.raises(CaptureError, match="is not a folder; expected a folder of views"):
        views_inside(folder, entry("sub/a.txt"))
    told = r"holds no cameras; expected transforms.json, transforms_train.json or sparse/0"
    with pytest.raises(CaptureError, match=told):
        views_inside(folder, entry("sub"))
    (folder / "sub" / "sparse" / "0").mkdir(parents=True)
    assert views_inside(folder, entry("sub")) == folder / "sub"
    (folder / "views").mkdir()
    (folder / "views" / "transforms.json").write_text("{}")
    assert views_inside(folder, entry("views")) == folder / "views"


SHAPES = {"position": (None, 3)}


def complaint(path: Path) -> str:
    with pytest.raises(CaptureError) as caught:
        read_arrays(path, SHAPES)
    line = str(caught.value)
    assert line.startswith(str(path)) and "expected" in line and "\n" not in line
    return line


def test_arrays_come_back_as_float64_with_nan(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, position=np.array([[1, 2, np.nan]], dtype=np.float32))
    array = read_arrays(path, SHAPES)["position"]
    assert array.dtype == np.float64 and np.array_equal(array, [[1, 2, np.nan]], equal_nan=True)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"position": np.array([[{}, 1, 2]], dtype=object)}, "position: holds Python objects"),
        ({"positions": np.zeros((2, 3))}, "positions: unknown array"),
        ({}, 'array "position" is missing'),
        ({"position": np.zeros((2, 3)), "time": np.zeros(2)}, "time: unknown array"),
        ({"position": np.zeros((2, 4))}, "position: has shape (2, 4); expected numbers of shape (T, 3)"),
        ({"position": np.zeros(3)}, "position: has shape (3,)"),
        ({"position": np.zeros((0, 3))}, "position: has shape (0, 3)"),
        ({"position": np.array([["a", "b", "c"]])}, "position: holds <U1"),
        ({"position": np.zeros((1, 3), dtype=complex)}, "position: holds complex128"),
        ({"position": np.array([[0, 1, 2], [0, np.inf, 2]])}, "position: is infinite at [1, 1]"),
    ],
)
def test_wrong_arrays_are_refused(tmp_path: Path, arrays: dict[str, np.ndarray], message: str) -> None:
    path = tmp_path / "a.npz"
    np.savez(path, **arrays)
    assert message in complaint(path)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_truncated_archives(tmp_path: Path, save: Callable[..., None]) -> None:
    path = tmp_path / "a.npz"
    save(path, position=np.random.default_rng(0).standard_normal((100, 3)))
    whole = path.read_bytes()
    for size in (0, 3, 60, len(whole) // 2, len(whole) - 10):
        path.write_bytes(whole[:size])
        assert "truncated" in complaint(path)
    damaged = bytearray(whole)
    damaged[300:400] = bytes(100)
    path.write_bytes(damaged)
    assert "damaged" in complaint(path) or "truncated" in complaint(path)


def test_a_file_that_is_no_archive(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.save(tmp_path / "a.npy", np.zeros((2, 3)))
    path.write_bytes((tmp_path / "a.npy").read_bytes())
    assert "is a single array" in complaint(path)
    path.write_text("position")
    assert "is not an .npz file" in complaint(path)
    np.save(tmp_path / "a.npy", np.array([{}], dtype=object))
    path.write_bytes((tmp_path / "a.npy").read_bytes())
    assert "is not an .npz file" in complaint(path)
