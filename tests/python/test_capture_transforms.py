"""transforms.json: read, written, refused."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mesh_picture import cameras_around
from mphygs.capture.errors import CaptureError
from mphygs.capture.transforms import read_transforms, write_transforms


@pytest.fixture
def document(tmp_path: Path) -> dict:
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "a.png").write_bytes(b"")
    turned = [[0, 0, 1, 0.5], [1, 0, 0, -0.25], [0, 1, 0, 0.125], [0, 0, 0, 1]]
    return {
        "camera_model": "OPENCV",
        "fl_x": 50,
        "fl_y": 60.5,
        "cx": 15,
        "cy": 11.5,
        "w": 32,
        "h": 24.0,
        "k1": 0.1,
        "p2": -0.01,
        "aabb_scale": 16,
        "frames": [{"file_path": "./images/a.png", "transform_matrix": turned, "colmap_im_id": 3}],
    }


def read(folder: Path, document: dict) -> list:
    (folder / "transforms.json").write_text(json.dumps(document))
    return read_transforms(folder / "transforms.json")


def test_a_nerfstudio_document(tmp_path: Path, document: dict) -> None:
    (shot,) = read(tmp_path, document)
    camera = shot.camera
    assert (camera.name, camera.width, camera.height, shot.frame) == ("a", 32, 24, None)
    assert shot.image == tmp_path / "images" / "a.png"
    np.testing.assert_array_equal(camera.focal, [50, 60.5])
    np.testing.assert_array_equal(camera.centre, [15, 11.5])
    np.testing.assert_array_equal(camera.distortion, [0.1, 0, 0, -0.01, 0, 0, 0, 0])
    np.testing.assert_allclose(camera.position, [0.5, -0.25, 0.125])
    # it looks along the matrix's -z, which is the world's -x
    np.testing.assert_allclose(camera.rays(camera.centre), [-1, 0, 0], atol=1e-12)


def test_intrinsics_of_a_frame_come_first(tmp_path: Path, document: dict) -> None:
    document["frames"][0] |= {"fl_x": 70, "w": 40, "camera": "left", "frame": 4}
    del document["fl_y"], document["cx"]
    (shot,) = read(tmp_path, document)
    assert (shot.camera.name, shot.frame, shot.camera.width) == ("left", 4, 40)
    np.testing.assert_array_equal(shot.camera.focal, [70, 70])
    np.testing.assert_array_equal(shot.camera.centre, [20, 11.5])


def test_angle_of_view(tmp_path: Path, document: dict) -> None:
    del document["fl_x"], document["fl_y"]
    document["camera_angle_x"] = math.pi / 2
    np.testing.assert_allclose(read(tmp_path, document)[0].camera.focal, [16, 16])


def test_written_cameras_come_back(tmp_path: Path) -> None:
    cameras = cameras_around(4, 32)
    for camera in cameras:
        (tmp_path / f"{camera.name}.png").write_bytes(b"")
    write_transforms(
        tmp_path / "transforms.json", cameras, [f"{c.name}.png" for c in cameras], [0, 1, 2, None]
    )
    shots = read_transforms(tmp_path / "transforms.json")
    assert [shot.frame for shot in shots] == [0, 1, 2, None]
    for shot, camera in zip(shots, cameras, strict=True):
        assert shot.camera.name == camera.name
        np.testing.assert_allclose(shot.camera.camera_from_world, camera.camera_from_world, atol=1e-12)
        np.testing.assert_array_equal(shot.camera.focal, camera.focal)


def change(**values: object) -> Callable[[dict], object]:
    return lambda document: document.update(values)


def in_frame(**values: object) -> Callable[[dict], object]:
    return lambda document: document["frames"][0].update(values)


def drop(key: str) -> Callable[[dict], object]:
    return lambda document: document.pop(key)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (change(frames=[]), "frames: is empty"),
        (change(fl_z=3), 'unknown key (did you mean "fl_'),
        (drop("w"), '"w" is missing'),
        (change(w=0), "w: is 0; expected a whole number"),
        (change(h=24.5), "h: is 24.5; expected a whole number"),
        (drop("fl_x"), '"fl_x" is missing'),
        (change(fl_x=-3), "focal lengths"),
        (change(camera_model="FISHEYE624"), "expected one of OPENCV"),
        (change(k4=0.1), "k4: is 0.1"),
        (change(fl_x="x"), "expected a number"),
        (in_frame(file_path="images/b.png"), "does not exist"),
        (in_frame(file_path="../secret.png"), "leads out of the folder"),
        (in_frame(mask_path="masks/a.png"), "mask_path"),
        (in_frame(frame=-1), "expected a frame, counted from 0"),
        (in_frame(transform_matrix=np.zeros((4, 4)).tolist()), "is singular"),
        (in_frame(transform_matrix=np.diag([1, 2, 1, 1]).tolist()), "no rigid motion"),
        (in_frame(transform_matrix=np.eye(3).tolist()), "has shape (3, 3)"),
        (in_frame(focal=3), "frames[0].focal: unknown key"),
    ],
)
def test_what_is_refused(
    tmp_path: Path, document: dict, spoil: Callable[[dict], object], message: str
) -> None:
    spoil(document)
    with pytest.raises(CaptureError) as caught:
        read(tmp_path, document)
    line = str(caught.value)
    assert message in line and str(tmp_path) in line and "\n" not in line and "expected" in line
