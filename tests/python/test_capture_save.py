"""A capture that is written reads back equal."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from capture_example import Example, shared
from mphygs.capture.errors import CaptureError
from mphygs.capture.format import Hold, load_capture, save_capture


def assert_same(a: object, b: object, where: str = "capture") -> None:
    """Equality of nested dataclasses and arrays, bit for bit, but for the folder they lie in."""
    assert type(a) is type(b), where
    if is_dataclass(a):
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name), f"{where}.{field.name}")
    elif isinstance(a, tuple):
        assert len(a) == len(b), where
        for index, pair in enumerate(zip(a, b, strict=True)):
            assert_same(*pair, f"{where}[{index}]")
    elif isinstance(a, np.ndarray):
        assert a.dtype == b.dtype and np.array_equal(a, b, equal_nan=True), where
    elif not isinstance(a, Path):
        assert a == b, where


def test_round_trip(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    example = Example(tmp_path / "one")
    example.sequence["markers"]["names"] = ["p", "q", "r", "s"]
    example.document["object"]["known"]["poissons_ratio"] = {"low": 0.1 + 0.2}
    capture = example.load()
    save_capture(capture, tmp_path / "deep" / "two")
    again = load_capture(tmp_path / "deep" / "two")
    assert_same(capture, again)
    save_capture(again, again.folder)
    assert_same(capture, load_capture(again.folder))


@pytest.mark.parametrize("name", ["silicone-beam", "practice/p1"])
def test_round_trip_of_recordings(tmp_path: Path, name: str) -> None:
    capture = load_capture(shared(*name.split("/")))
    save_capture(capture, tmp_path)
    assert_same(capture, load_capture(tmp_path))


def test_views_and_gaussians_travel_along(tmp_path: Path) -> None:
    (tmp_path / "one" / "film" / "images").mkdir(parents=True)
    example = Example(tmp_path / "one")
    (example.folder / "film" / "transforms.json").write_text("{}")
    (example.folder / "film" / "images" / "0.png").write_bytes(b"png")
    example.sequence["views"] = "film"
    example.document["object"] = {"gaussians": "low.ply", "rest": "equilibrium"}
    save_capture(example.load(), tmp_path / "two")
    again = load_capture(tmp_path / "two")
    assert again.gaussians.read_bytes() == (example.folder / "low.ply").read_bytes()
    assert (again.sequence("a").views / "images" / "0.png").read_bytes() == b"png"
    example.document["object"] = {"views": "film", "rest": "equilibrium"}
    save_capture(example.load(), tmp_path / "three")
    assert (load_capture(tmp_path / "three").views / "transforms.json").is_file()


def test_contradictions_are_not_written(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    capture = Example(tmp_path / "one").load()
    nowhere = replace(capture.sequences[0], held=(Hold(box=np.array([[5.0] * 3, [6.0] * 3])),))
    with pytest.raises(CaptureError, match=r"two.capture.json: sequences\[0\].held\[0\].box: no material"):
        save_capture(replace(capture, sequences=(nowhere,)), tmp_path / "two")
    bad = replace(capture, parts=(replace(capture.parts[0], name="../up"), capture.parts[1]))
    with pytest.raises(CaptureError, match=r"object.parts\[0\].name"):
        save_capture(bad, tmp_path / "two")
    assert not (tmp_path / "two").exists()
