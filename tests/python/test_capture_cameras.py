"""Cameras: axes, pixels, lens distortion."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from mphygs.capture.cameras import (
    Camera,
    camera_from_world_of_opengl,
    looking_at,
    opengl_of_camera,
)
from mphygs.capture.distortion import (
    distort_pixels,
    undistort_image,
    undistort_pixels,
    undistorted,
)


def eye(**changed: object) -> Camera:
    parts: dict = {
        "name": "a",
        "width": 64,
        "height": 48,
        "focal": np.array([80.0, 82.0]),
        "centre": np.array([31.0, 25.0]),
        "camera_from_world": looking_at(np.array([1.0, 2.0, 0.5]), np.array([0.1, 0.0, 0.2])),
    }
    return Camera(**parts | changed)


def test_looking_at_has_the_target_in_the_middle_and_up_upwards() -> None:
    camera = eye()
    points = np.array([[0.1, 0.0, 0.2], [0.1, 0.0, 0.3]])
    pixels, depth = camera.project(points)
    np.testing.assert_allclose(pixels[0], camera.centre, atol=1e-9)
    assert depth[0] == pytest.approx(np.linalg.norm([0.9, 2.0, 0.3]))
    assert pixels[1, 1] < pixels[0, 1] and pixels[1, 0] == pytest.approx(pixels[0, 0])
    np.testing.assert_allclose(camera.position, [1.0, 2.0, 0.5])
    # the world's y seen along -y: x of the world lies to the left when looking down -y with z up
    assert camera.project(np.array([[0.2, 0.0, 0.2]]))[0][0, 0] < camera.centre[0]


def test_points_behind_have_no_pixel() -> None:
    pixels, depth = eye().project(np.array([[2.0, 4.0, 0.6]]))
    assert depth[0] < 0 and np.isnan(pixels).all()


def test_rays_undo_projection() -> None:
    camera = eye()
    points = np.random.default_rng(0).normal(0, 0.2, (20, 3))
    pixels, _ = camera.project(points)
    away = points - camera.position
    np.testing.assert_allclose(
        camera.rays(pixels), away / np.linalg.norm(away, axis=1, keepdims=True), atol=1e-12
    )


def test_opengl_and_back() -> None:
    camera = eye()
    matrix = opengl_of_camera(camera)
    np.testing.assert_allclose(matrix[:3, 3], camera.position)
    # OpenGL: the camera looks along its -z and has y up
    np.testing.assert_allclose(-matrix[:3, 2], camera.rays(camera.centre))
    assert matrix[2, 1] > 0.9
    np.testing.assert_allclose(camera_from_world_of_opengl(matrix), camera.camera_from_world, atol=1e-12)


def test_a_resized_camera_sees_the_same() -> None:
    camera = eye()
    points = np.random.default_rng(0).normal(0, 0.2, (20, 3))
    half = camera.resized(32, 12)
    np.testing.assert_allclose(half.project(points)[0] * [2, 4], camera.project(points)[0], atol=1e-9)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"focal": np.array([80.0, -1.0])}, "focal lengths"),
        ({"focal": np.array([80.0])}, "focal is not"),
        ({"centre": np.array([np.nan, 1.0])}, "centre is not"),
        ({"width": 0}, "0 x 48 pixels"),
        ({"camera_from_world": np.diag([1.0, 1.0, -1.0, 1.0])}, "no rigid motion"),
        ({"camera_from_world": 2 * np.eye(4)}, "no rigid motion"),
        ({"distortion": np.zeros(4)}, "distortion is not"),
    ],
)
def test_numbers_that_are_no_camera(changed: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message) as caught:
        eye(**changed)
    assert 'camera "a"' in str(caught.value) and "\n" not in str(caught.value)


DISTORTION = np.array([-0.6, 0.2, 0.003, -0.002, 0.01, 0.0, 0.0, 0.0])


def test_distortion_is_undone_in_pixels() -> None:
    camera = eye(distortion=DISTORTION)
    points = np.random.default_rng(0).normal(0, 0.25, (30, 3))
    rotation = cv2.Rodrigues(camera.camera_from_world[:3, :3])[0]
    matrix = np.array([[80.0, 0, 31.0], [0, 82.0, 25.0], [0, 0, 1]])
    seen = cv2.projectPoints(points, rotation, camera.camera_from_world[:3, 3], matrix, DISTORTION)[0][:, 0]
    plain, _ = camera.project(points)
    assert np.abs(seen - plain).max() > 0.5
    np.testing.assert_allclose(undistort_pixels(camera, seen), plain, atol=1e-5)
    np.testing.assert_allclose(distort_pixels(camera, plain), seen, atol=1e-9)


def test_distortion_is_undone_in_pictures() -> None:
    """A blob drawn where the lens puts it ends where a pinhole camera sees it."""
    camera = eye(distortion=DISTORTION)
    target = np.array([[50.0, 38.0]])
    at = distort_pixels(camera, target)[0]
    assert np.linalg.norm(at - target) > 0.7
    v, u = np.mgrid[:48, :64] + 0.5
    image = np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / 4).astype(np.float32)
    straight = undistort_image(camera, image)
    found = [(straight * axis).sum() / straight.sum() for axis in (u, v)]
    np.testing.assert_allclose(found, target[0], atol=0.1)
    plain = undistorted(camera)
    assert not plain.distortion.any() and undistort_image(plain, image) is image
    assert dataclasses.replace(plain, distortion=DISTORTION).distortion.any()


def test_a_lens_that_cannot_be_undone() -> None:
    camera = eye(distortion=np.array([-20.0, 0, 0, 0, 0, 0, 0, 0]))
    with pytest.raises(ValueError, match='camera "a": its lens distortion cannot be undone'):
        undistort_pixels(camera, np.array([[63.0, 47.0]]))
