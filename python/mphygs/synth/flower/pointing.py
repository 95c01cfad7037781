"""What a person would point at in the pictures: the contact over time, points seen at rest and in frame 0."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mphygs.capture.cameras import Camera
from mphygs.capture.holds import Hold
from mphygs.synth.flower.drawing import SAMPLES, Painter
from mphygs.synth.flower.raster import hits

PIXEL_ERROR = 0.5  # standard deviation of where a person points to [px]
CONTACT_EVERY = 5  # frames
# Points that are pointed at, and in how many views of either kind.
POINTS, VIEWS = 12, 3
# How far behind the surface that is seen a point may be, to be the point that is seen [m].
BEHIND = 2e-4


def write_contact(
    path: Path, cameras: Sequence[Camera], hold: Hold, fps: float, place: np.ndarray, seed: int
) -> None:
    """contact.json: pixels, in every fifth frame, of the place (3,) [m] at rest where the hand holds."""
    generator = np.random.default_rng([seed, 16])
    assert hold.position is not None
    frames = np.arange(0, len(hold.position), CONTACT_EVERY)
    rotation, shift = hold.poses(frames / fps, fps)
    points = rotation @ place + shift
    document: dict[str, dict[str, list[float]]] = {}
    for camera in cameras:
        pixel = camera.project(points)[0] + PIXEL_ERROR * generator.standard_normal((len(points), 2))
        inside = _inside(camera, pixel)
        document[camera.name] = {
            str(frame): at.tolist() for frame, at, ok in zip(frames, pixel, inside, strict=True) if ok
        }
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def write_correspondences(
    path: Path,
    painter: Painter,
    at_rest: tuple[Sequence[Camera], np.ndarray],
    first: tuple[Sequence[Camera], np.ndarray],
    candidates: np.ndarray,
    seed: int,
) -> int:
    """correspondences.json: points seen in two or more rest views and in two or more views of frame 0.

    at_rest, first: cameras, and vertices (V, 3) [m] then; candidates: (M,) vertices, the first few that are
    seen often enough are taken. Returns how many there are.
    """
    generator = np.random.default_rng([seed, 17])
    sides = []
    for cameras, vertices in (at_rest, first):
        sides.append([(camera, *_seen(painter, camera, vertices, candidates)) for camera in cameras])
    document = []
    for k in range(len(candidates)):
        entry = {}
        for key, side in zip(("rest", "first"), sides, strict=True):
            views = [(camera, pixel[k]) for camera, pixel, seen in side if seen[k]]
            chosen = generator.permutation(len(views))[:VIEWS]
            entry[key] = {}
            for camera, pixel in (views[i] for i in sorted(chosen)):
                at = pixel + PIXEL_ERROR * generator.standard_normal(2)
                if _inside(camera, at[None])[0]:
                    entry[key][camera.name] = at.tolist()
        if min(len(views) for views in entry.values()) >= 2:
            document.append(entry)
        if len(document) == POINTS:
            break
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    return len(document)


def _seen(
    painter: Painter, camera: Camera, vertices: np.ndarray, chosen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (M, 2) of chosen vertices, and which of them nothing hides (M,)."""
    depth = hits(camera, vertices, painter.faces, samples=SAMPLES).depth_picture()
    pixel, own = camera.project(vertices[chosen])
    column, row = np.floor(SAMPLES * pixel).astype(int).T
    inside = _inside(camera, pixel) & (column < depth.shape[1]) & (row < depth.shape[0])
    seen = np.zeros(len(chosen), bool)
    seen[inside] = own[inside] <= depth[row[inside], column[inside]] + BEHIND
    # Where the sample beside a point misses the object, its edge is seen there, not the point.
    seen[inside] &= np.isfinite(depth[row[inside], column[inside]])
    return pixel, seen


def _inside(camera: Camera, pixel: np.ndarray) -> np.ndarray:
    return ((pixel >= 0) & (pixel <= [camera.width, camera.height])).all(axis=1)
