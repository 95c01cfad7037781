"""COLMAP models: text and binary give the same, damage is refused."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from mphygs.capture.colmap import read_colmap, read_colmap_points
from mphygs.capture.errors import CaptureError

HALF = 0.5
POSES = {"b.png": (1.0, 0.0, 0.0, 0.0, 0.1, 0.2, 0.3), "a.png": (HALF, HALF, HALF, HALF, 0.0, 0.0, 2.0)}
POINTS = [(7, 0.5, -0.25, 1.5, 255, 51, 0), (9, 1.0, 2.0, 3.0, 0, 0, 102)]


def write_text(folder: Path) -> None:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text(
        "# Camera list\n1 OPENCV 64 48 80 81 32 24 0.1 0.01 0.002 -0.001\n"
        "2 SIMPLE_RADIAL 64 48 70 31 25 -0.1\n"
    )
    images = "# Image list\n"
    for number, (name, pose) in enumerate(POSES.items(), start=1):
        seen = "10.5 20.5 7 3.0 4.0 -1" if number == 1 else ""  # a picture may see no points
        images += f"{number} {' '.join(map(str, pose))} {number} {name}\n{seen}\n"
    (model / "images.txt").write_text(images)
    rows = (" ".join(map(str, (*point, 0.5, 1, 0, 2, 1))) for point in POINTS)
    (model / "points3D.txt").write_text("# points\n" + "\n".join(rows) + "\n")


def write_binary(folder: Path) -> None:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    cameras = struct.pack("<Q", 2)
    cameras += struct.pack("<iiQQ8d", 1, 4, 64, 48, 80, 81, 32, 24, 0.1, 0.01, 0.002, -0.001)
    cameras += struct.pack("<iiQQ4d", 2, 2, 64, 48, 70, 31, 25, -0.1)
    (model / "cameras.bin").write_bytes(cameras)
    images = struct.pack("<Q", 2)
    for number, (name, pose) in enumerate(POSES.items(), start=1):
        images += struct.pack("<I7dI", number, *pose, number) + name.encode() + b"\0"
        images += struct.pack("<Q", 1) + struct.pack("<ddq", 1.0, 2.0, -1)
    (model / "images.bin").write_bytes(images)
    points = struct.pack("<Q", 2)
    for point in POINTS:
        points += struct.pack("<Q3d3Bd", *point, 0.5) + struct.pack("<Q", 2) + bytes(16)
    (model / "points3D.bin").write_bytes(points)


@pytest.fixture(params=[write_text, write_binary], ids=["text", "binary"])
def folder(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    request.param(tmp_path)
    (tmp_path / "images").mkdir()
    for name in POSES:
        (tmp_path / "images" / name).write_bytes(b"")
    return tmp_path


def test_cameras_and_points(folder: Path) -> None:
    first, second = read_colmap(folder)
    assert (first.camera.name, second.camera.name, first.frame) == ("a", "b", None)
    np.testing.assert_array_equal(first.camera.focal, [70, 70])
    np.testing.assert_array_equal(first.camera.centre, [31, 25])
    np.testing.assert_array_equal(first.camera.distortion, [-0.1, 0, 0, 0, 0, 0, 0, 0])
    np.testing.assert_array_equal(second.camera.distortion, [0.1, 0.01, 0.002, -0.001, 0, 0, 0, 0])
    np.testing.assert_allclose(second.camera.camera_from_world[:3, 3], [0.1, 0.2, 0.3])
    # the quaternion (1, 1, 1, 1) / 2 turns x to y, y to z, z to x
    np.testing.assert_allclose(
        first.camera.camera_from_world[:3, :3], [[0, 0, 1], [1, 0, 0], [0, 1, 0]], atol=1e-12
    )
    points = read_colmap_points(folder)
    np.testing.assert_allclose(points.positions, [[0.5, -0.25, 1.5], [1, 2, 3]])
    np.testing.assert_allclose(points.colours, [[1, 0.2, 0], [0, 0, 0.4]])


def complaint(folder: Path) -> str:
    with pytest.raises(CaptureError) as caught:
        read_colmap(folder)
        read_colmap_points(folder)
    line = str(caught.value)
    assert "\n" not in line and "expected" in line and str(folder) in line
    return line


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_truncated_files(folder: Path, name: str) -> None:
    (path,) = (folder / "sparse" / "0").glob(f"{name}.*")
    whole = path.read_bytes()
    path.write_bytes(whole[: -8 if path.suffix == ".bin" else -18])
    assert "damaged or truncated" in complaint(folder)
    path.unlink()
    assert f"has neither {name}.bin nor {name}.txt" in complaint(folder)


def test_missing_picture(folder: Path) -> None:
    (folder / "images" / "b.png").unlink()
    assert '"images/b.png" does not exist' in complaint(folder)


def test_frames_of_a_sequence(tmp_path: Path) -> None:
    write_text(tmp_path)
    path = tmp_path / "sparse" / "0" / "images.txt"
    path.write_text(path.read_text().replace("a.png", "left/012.png").replace("b.png", "right/012.png"))
    for side in ("left", "right"):
        (tmp_path / "images" / side).mkdir(parents=True)
        (tmp_path / "images" / side / "012.png").write_bytes(b"")
    assert [(shot.camera.name, shot.frame) for shot in read_colmap(tmp_path)] == [("left", 12), ("right", 12)]


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("cameras.txt", "SIMPLE_RADIAL", "FOV", "camera model FOV"),
        ("cameras.txt", "31 25 -0.1", "31 25", "has 3 parameters"),
        ("cameras.txt", "2 SIMPLE", "3 SIMPLE", "is of camera 2, which the model has not"),
        ("cameras.txt", "48 70", "48 nan", "not finite"),
        ("images.txt", "0.5 0.5 0.5 0.5", "0 0 0 0", "its quaternion is zero"),
        ("points3D.txt", "-0.25", "nan", "not finite"),
    ],
)
def test_numbers_that_are_refused(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    write_text(tmp_path)
    (tmp_path / "images").mkdir()
    for name in POSES:
        (tmp_path / "images" / name).write_bytes(b"")
    path = tmp_path / "sparse" / "0" / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new))
    assert message in complaint(tmp_path)
