"""Lens distortion undone, in pictures and in single pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from mphygs.capture.cameras import Camera

_ROUNDS = 50  # of a fixed point, far more than a usual lens needs
_CLOSE = 1e-3  # [px]


def undistorted(camera: Camera) -> Camera:
    """The pinhole camera with the same focal length and principal point."""
    return replace(camera, distortion=np.zeros_like(camera.distortion))


def _matrix(camera: Camera) -> np.ndarray:
    """OpenCV's matrix of the camera, whose first pixel has its centre at (0, 0)."""
    (focal_x, focal_y), (centre_x, centre_y) = camera.focal, camera.centre - 0.5
    return np.array([[focal_x, 0, centre_x], [0, focal_y, centre_y], [0, 0, 1.0]])


def undistort_image(camera: Camera, image: np.ndarray) -> np.ndarray:
    """The picture (H, W) or (H, W, C) that `undistorted(camera)` would have taken; 0 where it saw nothing."""
    if not camera.distortion.any():
        return image
    return cv2.undistort(image, _matrix(camera), camera.distortion)


def undistort_pixels(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Where points at `pixels` (N, 2) [px] of the picture as taken lie in the undistorted one, (N, 2).

    Raises ValueError where the lens bends too strongly there to be undone.
    """
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    if not camera.distortion.any() or len(pixels) == 0:
        return pixels
    straight = pixels
    for _ in range(_ROUNDS):
        straight = straight + pixels - distort_pixels(camera, straight)
    if not np.abs(pixels - distort_pixels(camera, straight)).max() < _CLOSE:
        raise ValueError(f'camera "{camera.name}": its lens distortion cannot be undone at the given pixels')
    return straight


def distort_pixels(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """The inverse of `undistort_pixels`."""
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    if len(pixels) == 0:
        return pixels
    ratio = (pixels - camera.centre) / camera.focal
    points = np.concatenate([ratio, np.ones((len(ratio), 1))], axis=1)
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), _matrix(camera), camera.distortion)
    return seen[:, 0] + 0.5
