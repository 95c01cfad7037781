"""A textured rod that is carried by one end and bends, seen by a few cameras: a video whose motion is known.

Drawn from its mesh by the z-buffer of the synthetic flowers: nothing is shared with the Gaussians' renderer.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import trimesh

from mphygs.capture.annotations import Correspondence
from mphygs.capture.cameras import Camera, looking_at
from mphygs.capture.images import write_image
from mphygs.capture.rotation import matrix_from_rotation_vector, quaternion_from_matrix
from mphygs.capture.transforms import write_transforms
from mphygs.capture.views import Photograph
from mphygs.scene.first_gaussians import gaussians_at
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.ply import write_gaussians
from mphygs.scene.tensor_rotation import rotation_matrices
from mphygs.synth.flower.raster import averaged, hits

LENGTH, WIDE, HIGH = 0.1, 0.016, 0.01  # [m], along x, y, z
HELD = 0.03  # [m], of the length, from 0, moves rigidly with the hand
FRAMES, SIZE, FPS = 8, 80, 50.0
_SAMPLES = 3
CONTACT = np.array([0.5 * HELD, 0.0, 0.0])


@dataclass(frozen=True)
class RodMotion:
    """start: rotation vector [rad] and shift [m] of frame 0 from rest; bend: largest curvature [1/m]."""

    start: tuple[tuple[float, float, float], tuple[float, float, float]] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    bend: float = 6.0

    def hand(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Rotation R (3, 3) and shift p (3,) [m] of the held end, x = R X + p."""
        share = frame / (FRAMES - 1)
        first = matrix_from_rotation_vector(np.array(self.start[0]))
        turn = matrix_from_rotation_vector(share**2 * np.array([0.25, 0.1, -0.15]))
        return turn @ first, turn @ np.array(self.start[1]) + share**2 * np.array([0.004, -0.008, 0.006])

    def __call__(self, points: np.ndarray, frame: int) -> np.ndarray:
        """Where points (N, 3) [m] at rest are in a frame: an arc beyond the held end, carried by the hand."""
        curvature = self.bend * np.sin(0.5 * np.pi * frame / (FRAMES - 1)) + 1e-9
        beyond = np.maximum(points[:, 0] - HELD, 0.0)
        angle = curvature * beyond
        line = np.stack(
            [
                np.minimum(points[:, 0], HELD) + np.sin(angle) / curvature,
                np.zeros(len(points)),
                -(1.0 - np.cos(angle)) / curvature,
            ],
            axis=1,
        )
        across = np.stack([np.sin(angle), np.zeros(len(points)), np.cos(angle)], axis=1)
        bent = line + across * points[:, 2:] + points[:, 1:2] * np.array([0.0, 1.0, 0.0])
        rotation, shift = self.hand(frame)
        return bent @ rotation.T + shift


def rod() -> trimesh.Trimesh:
    """The mesh at rest, triangles of about 3 mm."""
    box = trimesh.creation.box(extents=[LENGTH, WIDE, HIGH])
    box.apply_translation([0.5 * LENGTH, 0.0, 0.0])
    vertices, faces = trimesh.remesh.subdivide_to_size(box.vertices, box.faces, 0.004)
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    return mesh


def colours(points: np.ndarray) -> np.ndarray:
    """Colours (N, 3), 0 to 1, of material points (N, 3) [m]: waves of 12 to 30 mm, all different."""
    waves = np.array(
        [[230.0, 90.0, 40.0], [-120.0, 310.0, 80.0], [410.0, -60.0, 170.0], [170.0, 260.0, -330.0],
         [-290.0, 150.0, 240.0], [90.0, -380.0, 130.0]]
    )  # fmt: skip
    values = np.sin(points @ waves.T + np.arange(6.0))
    return 0.5 + 0.2 * values[:, :3] + 0.2 * values[:, 3:]


def cameras(count: int, size: int = SIZE, *, name: str = "camera", distance: float = 0.5) -> list[Camera]:
    """Cameras round the rod at several heights."""
    target = np.array([0.5 * LENGTH, 0.0, 0.0])
    found = []
    for k in range(count):
        bearing, height = 2.0 * np.pi * (k + 0.2) / count, np.radians([20.0, 50.0, -25.0][k % 3])
        way = np.array([np.cos(bearing) * np.cos(height), np.sin(bearing) * np.cos(height), np.sin(height)])
        pose = looking_at(target + distance * way, target)
        focal = np.full(2, size * distance / 0.16)
        found.append(Camera(f"{name}{k}", size, size, focal, np.full(2, 0.5 * size), pose))
    return found


def photograph(camera: Camera, mesh: trimesh.Trimesh, places: np.ndarray) -> Photograph:
    """The rod with its vertices at places (V, 3) [m]."""
    seen = hits(camera, places, mesh.faces, samples=_SAMPLES)
    material = seen.of_corners(np.asarray(mesh.vertices), mesh.faces)
    values = np.column_stack([colours(material), np.ones(len(material))])
    picture = averaged(values, seen, _SAMPLES).astype(np.float32)
    return Photograph(camera, picture[..., :3], picture[..., 3])


def frames_of(motion: RodMotion, seen_by: list[Camera]) -> list[list[Photograph]]:
    """The pictures of all cameras, frame by frame."""
    mesh = rod()
    places = [motion(np.asarray(mesh.vertices), frame) for frame in range(FRAMES)]
    return [[photograph(camera, mesh, place) for camera in seen_by] for place in places]


def gaussians(count: int = 2500) -> Gaussians:
    """Gaussians on the surface of the rod at rest, flat and of its colours."""
    mesh = rod()
    points, face = trimesh.sample.sample_surface_even(mesh, count, seed=1)
    first = gaussians_at(np.asarray(points), colours(np.asarray(points)), np.zeros((len(points), 0)))
    flat = first.scales * 0.55
    flat[:, 2] = 2e-4
    normals = np.asarray(mesh.face_normals)[face]
    axis = np.cross([0.0, 0.0, 1.0], normals)
    angle = np.arccos(np.clip(normals[:, 2], -1.0, 1.0))
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.where(length > 1e-6, axis / np.maximum(length, 1e-9), [1.0, 0.0, 0.0])
    turn = quaternion_from_matrix(matrix_from_rotation_vector(axis * angle[:, None]))
    rotations = torch.as_tensor(turn, dtype=torch.float32)
    assert torch.allclose(
        rotation_matrices(rotations)[:, :, 2], torch.as_tensor(normals, dtype=torch.float32), atol=1e-3
    )
    # sunk by as much as they are thick, so that the drawn rod is no thicker than the true one
    places = torch.as_tensor(np.asarray(points) - 4e-4 * normals, dtype=torch.float32)
    return Gaussians(
        places, rotations, flat, torch.full((len(points),), 0.95), first.harmonics, first.features
    )


def correspondences(motion: RodMotion, rest: list[Camera], first: list[Camera]) -> list[Correspondence]:
    """Ten points at rest and in frame 0, each in three views, half a pixel off."""
    draw = np.random.default_rng(3)
    points = draw.uniform([0.0, -0.5 * WIDE, 0.5 * HIGH], [LENGTH, 0.5 * WIDE, 0.5 * HIGH], (10, 3))
    found = []
    for point, place in zip(points, motion(points, 0), strict=True):
        sides = [
            {c.name: c.project(p[None])[0][0] + 0.3 * draw.standard_normal(2) for c in some[:3]}
            for some, p in ((rest, point), (first, place))
        ]
        found.append(Correspondence(*sides))
    return found


def write_rod_capture(folder: Path, motion: RodMotion, *, views: int = 4, held: bool = False) -> Path:
    """A capture of the rod in pictures; returns the file of its Gaussians, beside the folder.

    held: whether the capture tells the motion of the hand.
    """
    folder.mkdir(parents=True)
    mesh, at_rest, moving = rod(), cameras(9, 64, name="rest"), cameras(views)
    frames = frames_of(motion, moving)
    rest = [photograph(camera, mesh, np.asarray(mesh.vertices)) for camera in at_rest]
    _write_views(folder / "rest_views", [(p, None) for p in rest])
    video = folder / "views" / "carried"
    _write_views(video, [(p, frame) for frame, some in enumerate(frames) for p in some])
    contact: dict[str, dict[str, list[float]]] = {camera.name: {} for camera in moving}
    draw = np.random.default_rng(4)
    for frame in range(0, FRAMES, 2):
        rotation, shift = motion.hand(frame)
        for camera in moving:
            pixel = camera.project((rotation @ CONTACT + shift)[None])[0][0] + 0.3 * draw.standard_normal(2)
            contact[camera.name][str(frame)] = pixel.tolist()
    (video / "contact.json").write_text(json.dumps(contact))
    pairs = [
        {name: {k: v.tolist() for k, v in getattr(c, name).items()} for name in ("rest", "first")}
        for c in correspondences(motion, at_rest, moving)
    ]
    (video / "correspondences.json").write_text(json.dumps(pairs))
    sequence: dict[str, object] = {
        "name": "carried", "fps": FPS, "frames": FRAMES, "fit": [0, FRAMES], "views": "views/carried",
    }  # fmt: skip
    if held:
        poses = [motion.hand(frame) for frame in range(FRAMES)]
        np.savez(
            folder / "hold.npz",
            position=np.array([p for _, p in poses]),
            quaternion=quaternion_from_matrix(np.array([r for r, _ in poses])),
        )
        box = [[-1e-3, -0.5 * WIDE - 1e-3, -0.5 * HIGH - 1e-3], [HELD, 0.5 * WIDE + 1e-3, 0.5 * HIGH + 1e-3]]
        sequence["held"] = [{"box": box, "motion": "hold.npz"}]
    document = {
        "format": "mphygs-capture/1", "name": "rod", "gravity": [0.0, 0.0, -9.81],
        "object": {"views": "rest_views", "rest": "equilibrium"}, "sequences": [sequence],
    }  # fmt: skip
    (folder / "capture.json").write_text(json.dumps(document))
    file = folder.parent / "gaussians.ply"
    write_gaussians(file, gaussians(1200))
    return file


def _write_views(folder: Path, pictures: list[tuple[Photograph, int | None]]) -> None:
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True)
    files = []
    for picture, frame in pictures:
        name = f"{picture.camera.name}.png" if frame is None else f"{picture.camera.name}_{frame:03d}.png"
        write_image(folder / "images" / name, picture.colour)
        write_image(folder / "masks" / name, picture.mask)
        files.append(f"images/{name}")
    write_transforms(
        folder / "transforms.json", [p.camera for p, _ in pictures], files, [frame for _, frame in pictures]
    )
