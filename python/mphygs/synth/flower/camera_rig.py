"""Where the cameras stand: dense views all round the flower at rest, a few that watch it move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mphygs.capture.cameras import Camera, looking_at

# Of the cameras from what they look at, in radii of it.
DISTANCE = 5.0
# Share of half a picture that the points reach in the picture that they fill most.
FILLED = 0.93


def rest_cameras(points: np.ndarray, count: int, size: int) -> list[Camera]:
    """Cameras on a spiral about points (N, 3) [m], from below the horizon to nearly above; each sees all."""
    golden = np.pi * (3.0 - np.sqrt(5.0))
    sine = np.sin(np.radians(np.array([-24.0, 74.0])))
    heights = np.arcsin(sine[0] + (sine[1] - sine[0]) * (np.arange(count) + 0.5) / count)
    return _cameras("rest", points, golden * np.arange(count), heights, size)


def sequence_cameras(points: np.ndarray, count: int, size: int) -> list[Camera]:
    """Cameras round everything that points (N, 3) [m] of the motion sweep, at alternating heights."""
    bearings = 2.0 * np.pi * (np.arange(count) + 0.15) / count
    heights = np.radians(np.resize([12.0, 32.0, 5.0, 48.0, 20.0], count))
    return _cameras("camera", points, bearings, heights, size)


def _cameras(
    name: str, points: np.ndarray, bearings: np.ndarray, heights: np.ndarray, size: int
) -> list[Camera]:
    target = 0.5 * (points.min(axis=0) + points.max(axis=0))
    distance = DISTANCE * float(np.linalg.norm(points - target, axis=1).max())
    digits = len(str(len(bearings) - 1))
    cameras = []
    for number, (bearing, height) in enumerate(zip(bearings, heights, strict=True)):
        direction = np.array(
            [np.cos(bearing) * np.cos(height), np.sin(bearing) * np.cos(height), np.sin(height)]
        )
        pose = looking_at(target + distance * direction, target)
        # of focal length 1 first, to see how far the points reach
        cameras.append(Camera(f"{name}{number:0{digits}d}", size, size, np.ones(2), np.zeros(2), pose))
    reach = max(float(np.abs(camera.project(points)[0]).max()) for camera in cameras)
    focal = np.full(2, 0.5 * size * FILLED / reach)
    return [replace(camera, focal=focal, centre=np.full(2, 0.5 * size)) for camera in cameras]
