"""A small mesh renderer (z-buffer, colours by place) that shares nothing with the Gaussian one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from mphygs.capture.cameras import Camera, looking_at
from mphygs.capture.images import write_image
from mphygs.capture.transforms import write_transforms

_SAMPLES = 3  # along each side of a pixel


def coloured(points: np.ndarray) -> np.ndarray:
    """A smooth colour (N, 3), 0 to 1, for places (N, 3) [m]."""
    phase = points @ np.array([[60.0, 0, 20], [0, 70, -10], [15, 0, 50]]) + [0.0, 1.0, 2.0]
    return 0.5 + 0.4 * np.sin(phase)


def draw_mesh(camera: Camera, mesh: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    """Colour (H, W, 3) over black and coverage (H, W), 0 to 1."""
    fine = camera.resized(camera.width * _SAMPLES, camera.height * _SAMPLES)
    pixels, depths = fine.project(mesh.vertices)
    nearest = np.full((fine.height, fine.width), np.inf)
    colour = np.zeros((fine.height, fine.width, 3))
    for face in mesh.faces:
        corners, inverse_depth = pixels[face], 1 / depths[face]
        low = np.maximum(np.floor(corners.min(0) - 0.5), 0).astype(int)
        high = np.minimum(np.ceil(corners.max(0) + 0.5), [fine.width, fine.height]).astype(int)
        edges = np.column_stack([corners[1] - corners[0], corners[2] - corners[0]])
        if (high <= low).any() or abs(np.linalg.det(edges)) < 1e-12:
            continue
        v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
        second = (np.stack([u, v], -1) + 0.5 - corners[0]) @ np.linalg.inv(edges).T
        weights = np.concatenate([1 - second.sum(-1, keepdims=True), second], -1)
        inside = (weights >= -1e-9).all(-1)
        z = 1 / np.where(inside, weights @ inverse_depth, 1.0)
        region = nearest[low[1] : high[1], low[0] : high[0]]
        front = inside & (z < region)
        # perspective: barycentric weights over depth
        places = (weights[front] * inverse_depth * z[front][:, None]) @ mesh.vertices[face]
        region[front] = z[front]
        colour[low[1] : high[1], low[0] : high[0]][front] = coloured(places)
    blocks = (camera.height, _SAMPLES, camera.width, _SAMPLES)
    coverage = np.isfinite(nearest).astype(float).reshape(blocks).mean((1, 3))
    return colour.reshape(*blocks, 3).mean((1, 3)), coverage


def dumbbell() -> trimesh.Trimesh:
    """Two balls of unlike size and a bar between them, 0.1 m across, as one set of triangles."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.025).apply_translation([0.03, 0.0, 0.005])
    other = trimesh.creation.icosphere(subdivisions=2, radius=0.016).apply_translation([-0.035, 0.005, 0.0])
    bar = trimesh.creation.box(extents=[0.07, 0.012, 0.012])
    return trimesh.util.concatenate([ball, other, bar])


def cameras_around(count: int, size: int, *, first: float = 0.0, distance: float = 0.3) -> list[Camera]:
    """Cameras on a sphere about the origin, alternating between three heights, all seeing 0.12 m."""
    cameras = []
    for index in range(count):
        angle, height = first + 2 * np.pi * index / count, (0.35, -0.3, 1.0)[index % 3]
        place = distance * np.array(
            [np.cos(angle) * np.cos(height), np.sin(angle) * np.cos(height), np.sin(height)]
        )
        focal = np.full(2, size * distance / 0.13)
        cameras.append(
            Camera(
                f"view{index:02d}", size, size, focal, np.full(2, size / 2), looking_at(place, np.zeros(3))
            )
        )
    return cameras


def write_rest_views(folder: Path, cameras: list[Camera], *, masks: str = "masks") -> None:
    """A folder of rest views of the dumbbell; masks: "masks" (files), "alpha" or "background"."""
    mesh = dumbbell()
    for name in ("images", masks) if masks != "alpha" else ("images",):
        (folder / name).mkdir(parents=True, exist_ok=True)
    for camera in cameras:
        colour, coverage = draw_mesh(camera, mesh)
        picture = colour if masks != "alpha" else np.concatenate([colour, coverage[..., None]], -1)
        write_image(folder / "images" / f"{camera.name}.png", picture)
        if masks == "masks":
            write_image(folder / "masks" / f"{camera.name}.png", coverage)
        elif masks == "background":
            write_image(folder / "background" / f"{camera.name}.png", np.zeros_like(colour))
    files = [f"images/{camera.name}.png" for camera in cameras]
    write_transforms(folder / "transforms.json", cameras, files, [None] * len(cameras))
