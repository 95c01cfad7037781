"""Lenses that are fisheyes: from the angle off their axis to the place in the picture, and back.

A ray at the angle theta from the axis, in the direction (a, b) about it, has the place (u, v) = theta (a, b).
The picture has, over the focal length, with r = |(u, v)|,

    u (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + 2 p1 u v + p2 (r^2 + 2 u^2) + sx1 r^2
    v (1 + k1 r^2 + k2 r^4 + k3 r^6 + k4 r^8) + 2 p2 u v + p1 (r^2 + 2 v^2) + sy1 r^2

With k1 to k4 alone this is OpenCV's fisheye model (Kannala and Brandt 2006); with all of it COLMAP's
THIN_PRISM_FISHEYE.
"""

from __future__ import annotations

import numpy as np

_ROUNDS = 100  # of a fixed point, far more than a usual lens needs
_CLOSE = 1e-9  # [1], over the focal length
# Rays this near a right angle to the axis have no place in a picture without distortion.
_WIDEST = np.pi / 2 - 1e-3


def bend(lens: np.ndarray, straight: np.ndarray) -> np.ndarray:
    """Where points that a pinhole camera sees at `straight` (N, 2) are seen, both over the focal length.

    lens: (8,), k1 k2 k3 k4 p1 p2 sx1 sy1. NaN beyond the angle at which the lens would fold the picture over.
    """
    radius = np.linalg.norm(straight, axis=1, keepdims=True)
    angle = np.arctan(radius)
    place = straight * np.where(radius > 1e-12, angle / np.maximum(radius, 1e-12), 1.0)
    return np.where(angle < _folding_angle(lens), _moved(lens, place), np.nan)


def straighten(lens: np.ndarray, bent: np.ndarray) -> np.ndarray:
    """The inverse of `bend`; NaN where there is none, and for rays that no pinhole camera has."""
    place = bent
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(_ROUNDS):
            place = place + bent - _moved(lens, place)
        angle = np.linalg.norm(place, axis=1, keepdims=True)
        found = np.abs(bent - _moved(lens, place)).max(axis=1, keepdims=True) < _CLOSE
        found &= angle < min(_WIDEST, _folding_angle(lens))
        scale = np.where(angle > 1e-12, np.tan(angle) / np.maximum(angle, 1e-12), 1.0)
        return np.where(found, place * scale, np.nan)


def _moved(lens: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Places (N, 2) that a lens without errors would give as this one gives them."""
    k1, k2, k3, k4, p1, p2, sx, sy = lens
    u, v = place[:, 0], place[:, 1]
    r2 = u * u + v * v
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)))
    return np.stack(
        [
            u * radial + 2.0 * p1 * u * v + p2 * (r2 + 2.0 * u * u) + sx * r2,
            v * radial + 2.0 * p2 * u * v + p1 * (r2 + 2.0 * v * v) + sy * r2,
        ],
        axis=1,
    )


def _folding_angle(lens: np.ndarray) -> float:
    """The angle beyond which a larger one is seen nearer the middle again; infinite where there is none."""
    k1, k2, k3, k4 = lens[:4]
    roots = np.roots([9.0 * k4, 7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
    real = roots[np.abs(roots.imag) < 1e-9].real
    return float(np.sqrt(real[real > 0].min(initial=np.inf)))
