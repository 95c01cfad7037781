"""Cameras that see the object where the others do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mesh_picture import cameras_around, dumbbell
from mphygs.capture.cameras import Camera
from mphygs.capture.errors import CaptureError
from mphygs.capture.rotation import matrix_from_rotation_vector
from mphygs.capture.views import Photograph
from mphygs.motion.camera_check import check_cameras
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians, harmonics_of_colour

SIZE = 64


def scene() -> tuple[Gaussians, np.ndarray, list[Photograph]]:
    """Gaussians at rest, where they have gone, and what five cameras see of them there."""
    points = torch.as_tensor(np.array(dumbbell().vertices), dtype=torch.float32)
    count = len(points)
    gaussians = Gaussians(
        positions=points,
        rotations=torch.tensor([[1.0, 0, 0, 0]]).repeat(count, 1),
        scales=torch.full((count, 3), 0.004),
        opacities=torch.full((count,), 0.9),
        harmonics=harmonics_of_colour(torch.full((count, 3), 0.7)),
        features=torch.ones(count, 2),
    )
    moved = points.double().numpy() + [0.01, -0.005, 0.0]
    there = replace(gaussians, positions=torch.as_tensor(moved, dtype=torch.float32))
    photographs = []
    for camera in cameras_around(5, SIZE, first=0.3):
        picture = splat(there, camera)
        mask = (picture.opacity.numpy() >= 0.5).astype(np.float32)
        photographs.append(Photograph(camera, picture.colour.numpy(), mask))
    return gaussians, moved, photographs


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera as if it looked elsewhere by that angle."""
    pose = camera.camera_from_world.copy()
    pose[:3] = matrix_from_rotation_vector(np.radians([0.0, degrees, 0.0])) @ pose[:3]
    return replace(camera, camera_from_world=pose)


def test_cameras_that_agree_do() -> None:
    gaussians, moved, photographs = scene()
    found = check_cameras(gaussians, moved, photographs, where="frog")
    assert list(found) == [p.camera.name for p in photographs] and min(found.values()) > 0.99


def test_a_camera_that_looks_elsewhere_is_named() -> None:
    gaussians, moved, photographs = scene()
    photographs[3] = replace(photographs[3], camera=turned(photographs[3].camera, 15.0))
    name = photographs[3].camera.name
    with pytest.raises(CaptureError, match=f'frog: camera "{name}" shares .*% of its silhouette.*left out'):
        check_cameras(gaussians, moved, photographs, where="frog")


def test_nobody_is_blamed_where_the_object_is_not_found() -> None:
    gaussians, moved, photographs = scene()
    with pytest.raises(CaptureError, match="frog: the object is not found where the cameras see it"):
        check_cameras(gaussians, moved + [0.0, 0.0, 1.0], photographs, where="frog")
