"""Lens distortion undone, in pictures and in single pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from mphygs.capture.cameras import Camera
from mphygs.capture.fisheye import bend, straighten

_ROUNDS = 50  # of a fixed point, far more than a usual lens needs
_CLOSE = 1e-3  # [px]


def undistorted(camera: Camera) -> Camera:
    """The pinhole camera with the same focal length and principal point."""
    return replace(camera, distortion=np.zeros_like(camera.distortion), fisheye=None)


def _matrix(camera: Camera) -> np.ndarray:
    """OpenCV's matrix of the camera, whose first pixel has its centre at (0, 0)."""
    (focal_x, focal_y), (centre_x, centre_y) = camera.focal, camera.centre - 0.5
    return np.array([[focal_x, 0, centre_x], [0, focal_y, centre_y], [0, 0, 1.0]])


def undistort_image(camera: Camera, image: np.ndarray) -> np.ndarray:
    """The picture (H, W) or (H, W, C) that `undistorted(camera)` would have taken; 0 where it saw nothing."""
    if camera.fisheye is not None:
        return _remapped(camera, image)
    if not camera.distortion.any():
        return image
    return cv2.undistort(image, _matrix(camera), camera.distortion)


def _remapped(camera: Camera, image: np.ndarray) -> np.ndarray:
    """The picture of a fisheye as a pinhole camera would have taken it, row by row of pixels."""
    height, width = image.shape[:2]
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    seen = distort_pixels(camera, np.stack([column.ravel(), row.ravel()], axis=1)) - 0.5
    # OpenCV takes no NaN for a place
    x, y = np.nan_to_num(seen, nan=-10.0).astype(np.float32).T.reshape(2, height, width)
    return cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)


def undistort_pixels(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Where points at `pixels` (N, 2) [px] of the picture as taken lie in the undistorted one, (N, 2).

    Raises ValueError where the lens bends too strongly there to be undone.
    """
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    if len(pixels) == 0 or (camera.fisheye is None and not camera.distortion.any()):
        return pixels
    if camera.fisheye is not None:
        straight = straighten(camera.fisheye, (pixels - camera.centre) / camera.focal)
        straight = straight * camera.focal + camera.centre
    else:
        straight = pixels
        for _ in range(_ROUNDS):
            straight = straight + pixels - distort_pixels(camera, straight)
    if not np.abs(pixels - distort_pixels(camera, straight)).max() < _CLOSE:
        raise ValueError(f'camera "{camera.name}": its lens distortion cannot be undone at the given pixels')
    return straight


def distort_pixels(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """The inverse of `undistort_pixels`; NaN where a fisheye would fold the picture over."""
    pixels = np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    if len(pixels) == 0:
        return pixels
    ratio = (pixels - camera.centre) / camera.focal
    if camera.fisheye is not None:
        return bend(camera.fisheye, ratio) * camera.focal + camera.centre
    points = np.concatenate([ratio, np.ones((len(ratio), 1))], axis=1)
    seen, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), _matrix(camera), camera.distortion)
    return seen[:, 0] + 0.5
