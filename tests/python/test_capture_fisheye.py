"""Fisheye lenses: what is seen through one comes back where a pinhole camera sees it."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from mphygs.capture.cameras import Camera, looking_at, opengl_of_camera
from mphygs.capture.distortion import distort_pixels, undistort_pixels, undistorted
from mphygs.capture.errors import CaptureError
from mphygs.capture.images import write_image
from mphygs.capture.rotation import quaternion_from_matrix
from mphygs.capture.transforms import read_transforms, write_transforms
from mphygs.capture.view_folders import load_rest_views

WIDTH, HEIGHT, FOCAL, CENTRE = 240, 200, np.array([92.0, 90.0]), np.array([118.0, 103.0])
# k1 k2 k3 k4 as action cameras have them
LENS = np.array([0.08, -0.03, 0.015, -0.004])
COUNT = 4


def camera(number: int, lens: np.ndarray | None = LENS, focal: np.ndarray = FOCAL) -> Camera:
    """A camera near the object, so that it spans 60 degrees of the picture."""
    angle = 2 * np.pi * number / COUNT
    place = np.array([0.2 * np.cos(angle), 0.2 * np.sin(angle), 0.07])
    fisheye = None if lens is None else np.concatenate([lens, np.zeros(8 - len(lens))])
    pose = looking_at(place, np.array([0.0, 0.02, 0.0]))
    return Camera(f"v{number}", WIDTH, HEIGHT, focal, CENTRE, pose, fisheye=fisheye)


def dots() -> np.ndarray:
    """(N, 3) places [m] far apart in every picture."""
    return 0.08 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-0.8, 0.9)] + [[0, 0, 0.0]])


def seen_by_opencv(one: Camera, points: np.ndarray, lens: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) where OpenCV's fisheye camera sees points (N, 3)."""
    matrix = np.diag([*one.focal, 1.0])
    matrix[:2, 2] = one.centre - 0.5
    turn = cv2.Rodrigues(one.camera_from_world[:3, :3])[0]
    shift = one.camera_from_world[:3, 3]
    return cv2.fisheye.projectPoints(points[:, None], turn, shift, matrix, lens)[0][:, 0] + 0.5


def seen_by_colmap(one: Camera, points: np.ndarray, lens: np.ndarray) -> np.ndarray:
    """The same as COLMAP writes its THIN_PRISM_FISHEYE down. lens: k1 k2 p1 p2 k3 k4 sx1 sy1."""
    k1, k2, p1, p2, k3, k4, sx1, sy1 = lens
    found = []
    for point in points:
        x, y, z = one.camera_from_world[:3, :3] @ point + one.camera_from_world[:3, 3]
        u, v = x / z, y / z
        r = np.hypot(u, v)
        theta = np.arctan(r)
        u, v = u * theta / r, v * theta / r
        u2, uv, v2 = u * u, u * v, v * v
        r2 = u2 + v2
        radial = k1 * r2 + k2 * r2**2 + k3 * r2**3 + k4 * r2**4
        du = u * radial + 2 * p1 * uv + p2 * (r2 + 2 * u2) + sx1 * r2
        dv = v * radial + 2 * p2 * uv + p1 * (r2 + 2 * v2) + sy1 * r2
        found.append(one.focal * [u + du, v + dv] + one.centre)
    return np.array(found)


def draw(folder: Path, names: list[str], see) -> None:  # noqa: ANN001 (a function of a camera's number)
    """Pictures with a dot where each place is seen, their masks the same dots."""
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True)
    for k, name in enumerate(names):
        image = np.zeros((HEIGHT, WIDTH))
        for x, y in see(k):
            image += np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 2.0**2))
        write_image(folder / "images" / name, np.repeat(image.clip(0, 1)[..., None], 3, axis=2))
        write_image(folder / "masks" / name, (image > 0.3).astype(float))


def errors(folder: Path) -> tuple[float, float]:
    """How far dots in pictures and masks are from where a pinhole camera sees them, at most [px]."""
    v, u = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    worst = [0.0, 0.0]
    for photograph in load_rest_views(folder).read():
        assert photograph.camera.fisheye is None and not photograph.camera.distortion.any()
        np.testing.assert_array_equal(photograph.camera.centre, CENTRE)
        pixels, _ = photograph.camera.project(dots())
        inside = ((pixels > 12) & (pixels < [WIDTH - 12, HEIGHT - 12])).all(axis=1)
        assert inside.sum() >= 5
        for which, values in enumerate((photograph.colour[..., 0], photograph.mask)):
            for x, y in pixels[inside]:
                near = values * ((u - x) ** 2 + (v - y) ** 2 < 9.0**2)
                assert near.sum() > 5
                off = [(near * axis).sum() / near.sum() - at for axis, at in ((u, x), (v, y))]
                worst[which] = max(worst[which], float(np.hypot(*off)))
    return worst[0], worst[1]


NAMES = [f"view{k}.png" for k in range(COUNT)]


def transforms(folder: Path, lens: np.ndarray, keys: dict) -> Path:
    """A transforms.json of pictures through a lens of OpenCV."""
    draw(folder, NAMES, lambda k: seen_by_opencv(camera(k), dots(), lens))
    document = {
        "w": WIDTH, "h": HEIGHT, "fl_x": FOCAL[0], "fl_y": FOCAL[1], "cx": CENTRE[0], "cy": CENTRE[1],
        **{f"k{k + 1}": value for k, value in enumerate(lens)}, **keys,
        "frames": [
            {"file_path": f"images/{name}", "transform_matrix": opengl_of_camera(camera(k)).tolist()}
            for k, name in enumerate(NAMES)
        ],
    }  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


@pytest.mark.parametrize(
    "keys", [{"camera_model": "OPENCV_FISHEYE"}, {"is_fisheye": True, "p1": 0.0, "p2": 0.0}]
)
def test_transforms_of_nerfstudio_and_instant_ngp(keys: dict, tmp_path: Path) -> None:
    picture, mask = errors(transforms(tmp_path, LENS, keys))
    assert picture < 0.2 and mask < 0.5
    # Not undone, the dots are elsewhere.
    plain = [
        np.abs(seen_by_opencv(camera(k), dots(), LENS) - camera(k).project(dots())[0]) for k in range(COUNT)
    ]
    assert np.max(plain) > 8


def colmap(folder: Path, model: str, number: int, parameters: list[float], *, binary: bool) -> Path:
    path = folder / "sparse" / "0"
    path.mkdir(parents=True)
    if binary:
        numbers = struct.pack("<QiiQQ", 1, 1, number, WIDTH, HEIGHT)
        (path / "cameras.bin").write_bytes(numbers + struct.pack(f"<{len(parameters)}d", *parameters))
    else:
        words = " ".join(map(str, parameters))
        (path / "cameras.txt").write_text(f"1 {model} {WIDTH} {HEIGHT} {words}\n")
    lines = []
    for k, name in enumerate(NAMES):
        pose = camera(k).camera_from_world
        numbers = " ".join(map(str, [*quaternion_from_matrix(pose[:3, :3]), *pose[:3, 3]]))
        lines.append(f"{k + 1} {numbers} 1 {name}\n\n")
    (path / "images.txt").write_text("".join(lines))
    (path / "points3D.txt").write_text("")
    return folder


@pytest.mark.parametrize("binary", [True, False], ids=["binary", "text"])
@pytest.mark.parametrize(
    ("model", "number", "count"),
    [("OPENCV_FISHEYE", 5, 4), ("SIMPLE_RADIAL_FISHEYE", 8, 1), ("RADIAL_FISHEYE", 9, 2)],
)
def test_fisheyes_of_colmap(model: str, number: int, count: int, binary: bool, tmp_path: Path) -> None:
    lens = np.where(np.arange(4) < count, LENS, 0.0)
    focal = FOCAL if count == 4 else np.full(2, 91.0)
    draw(tmp_path, NAMES, lambda k: seen_by_opencv(camera(k, focal=focal), dots(), lens))
    own = [*(focal if count == 4 else focal[:1]), *CENTRE, *lens[:count]]
    picture, mask = errors(colmap(tmp_path, model, number, own, binary=binary))
    assert picture < 0.2 and mask < 0.5


def test_the_thin_prism_of_colmap(tmp_path: Path) -> None:
    lens = np.array([0.05, -0.02, 0.006, -0.004, 0.01, -0.003, 0.008, -0.005])
    draw(tmp_path, NAMES, lambda k: seen_by_colmap(camera(k), dots(), lens))
    own = [*FOCAL, *CENTRE, *lens]
    picture, mask = errors(colmap(tmp_path, "THIN_PRISM_FISHEYE", 10, own, binary=True))
    assert picture < 0.2 and mask < 0.5


@pytest.mark.parametrize(
    "lens", [LENS, np.zeros(4), np.array([0.05, -0.02, 0.01, -0.003, 0.006, -0.004, 0.008, 0.0])]
)
def test_pixels_go_there_and_back(lens: np.ndarray) -> None:
    one = camera(0, lens)
    pixels = np.array([[x, y] for x in (-60.0, 50.0, 118.0, 230.0, 400.0) for y in (-40.0, 103.0, 260.0)])
    np.testing.assert_allclose(undistort_pixels(one, distort_pixels(one, pixels)), pixels, atol=1e-4)
    if not lens[4:].any():
        points = dots()
        np.testing.assert_allclose(
            distort_pixels(one, one.project(points)[0]), seen_by_opencv(one, points, lens), atol=1e-6
        )
    assert undistorted(one).fisheye is None


def test_what_no_pinhole_camera_sees_is_refused() -> None:
    one = camera(0, np.zeros(4))
    beyond = CENTRE + [[FOCAL[0] * 1.65, 0.0]]  # 94 degrees off the axis
    with pytest.raises(ValueError, match='camera "v0": its lens distortion cannot be undone'):
        undistort_pixels(one, beyond)
    # A lens that folds beyond 50 degrees shows nothing there.
    folding = camera(0, np.array([-1 / (3 * np.radians(50) ** 2), 0, 0, 0]))
    seen = distort_pixels(folding, CENTRE + FOCAL * np.tan(np.radians([[45.0, 0.0], [55.0, 0.0]])))
    assert np.isfinite(seen[0]).all() and np.isnan(seen[1]).all()


def test_written_fisheyes_come_back(tmp_path: Path) -> None:
    cameras = [camera(k) for k in range(COUNT)]
    for name in NAMES:
        write_image(tmp_path / name, np.zeros((HEIGHT, WIDTH, 3)))
    write_transforms(tmp_path / "transforms.json", cameras, NAMES, [None] * COUNT)
    for shot, one in zip(read_transforms(tmp_path / "transforms.json"), cameras, strict=True):
        np.testing.assert_array_equal(shot.camera.fisheye, one.fisheye)
    prism = camera(0, np.array([0, 0, 0, 0, 0.1, 0, 0, 0]))
    with pytest.raises(ValueError, match="its distortion has no place in transforms.json"):
        write_transforms(tmp_path / "transforms.json", [prism], NAMES[:1], [None])


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        (
            {"is_fisheye": True, "p1": 0.1},
            "p1: is 0.1; expected 0: distortion of a fisheye is k1, k2, k3, k4",
        ),
        ({"camera_model": "EQUIRECTANGULAR"}, 'camera_model: is "EQUIRECTANGULAR"; expected one of OPENCV'),
        ({"is_fisheye": "no"}, 'is_fisheye: is "no"; expected true or false'),
    ],
)
def test_lenses_that_are_refused(keys: dict, words: str, tmp_path: Path) -> None:
    with pytest.raises(CaptureError) as caught:
        load_rest_views(transforms(tmp_path, LENS, keys))
    assert words in str(caught.value)
    with pytest.raises(CaptureError, match="camera model FOV; expected one of SIMPLE_PINHOLE"):
        (tmp_path / "transforms.json").unlink()
        load_rest_views(colmap(tmp_path, "FOV", 7, [90, 90, 120, 100, 0.5], binary=False))
