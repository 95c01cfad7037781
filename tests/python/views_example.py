"""A folder of rest views as other programs write it, that tests change in one place at a time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mphygs.capture.cameras import Camera, looking_at, opengl_of_camera
from mphygs.capture.errors import CaptureError
from mphygs.capture.images import write_image
from mphygs.capture.rotation import quaternion_from_matrix
from mphygs.capture.view_folders import load_rest_views

SIZE, COUNT = 32, 6


def camera(number: int, *, unit: float = 1.0) -> Camera:
    angle = 2 * np.pi * number / COUNT
    place = unit * np.array([0.4 * np.cos(angle), 0.4 * np.sin(angle), 0.15])
    pose = looking_at(place, np.zeros(3))
    return Camera(f"v{number}", SIZE, SIZE, np.full(2, 60.0), np.full(2, SIZE / 2), pose)


def picture() -> tuple[np.ndarray, np.ndarray]:
    """A grey picture with a bright square in its middle, and the mask of that."""
    mask = np.zeros((SIZE, SIZE))
    mask[10:22, 12:20] = 1.0
    return np.repeat((0.2 + 0.6 * mask)[..., None], 3, axis=2), mask


class Rest:
    """A folder of rest views; its document is changed by the tests, its pictures are named by them."""

    def __init__(self, folder: Path, names: list[str] | None = None, *, unit: float = 1.0) -> None:
        self.folder = folder
        self.names = names or [f"images/view{k}.png" for k in range(COUNT)]
        colour, mask = picture()
        frames = []
        for k, name in enumerate(self.names):
            for kind, values in (("images", colour), ("masks", mask)):
                path = folder / (name if kind == "images" else name.replace("images/", "masks/", 1))
                path.parent.mkdir(parents=True, exist_ok=True)
                write_image(path, values)
            matrix = opengl_of_camera(camera(k, unit=unit)).tolist()
            frames.append({"file_path": name, "transform_matrix": matrix})
        self.document: dict[str, Any] = {
            "w": SIZE, "h": SIZE, "fl_x": 60.0, "fl_y": 60.0, "cx": SIZE / 2, "cy": SIZE / 2, "frames": frames
        }  # fmt: skip

    def write(self) -> Path:
        (self.folder / "transforms.json").write_text(json.dumps(self.document))
        return self.folder

    def complaint(self) -> str:
        with pytest.raises(CaptureError) as caught:
            load_rest_views(self.write()).read()
        line = str(caught.value)
        assert "\n" not in line and "expected" in line
        return line

    def write_colmap(self, where: str, lens: str, *, unit: float = 1.0) -> Path:
        """The same as a COLMAP model of one lens, e.g. "PINHOLE 32 32 60 60 16 16", with two points."""
        model = self.folder / where
        model.mkdir(parents=True)
        (model / "cameras.txt").write_text(f"1 {lens}\n")
        lines = []
        for k, name in enumerate(self.names):
            pose = camera(k, unit=unit).camera_from_world
            numbers = [*quaternion_from_matrix(pose[:3, :3]), *pose[:3, 3]]
            lines.append(f"{k + 1} {' '.join(map(str, numbers))} 1 {name.removeprefix('images/')}\n\n")
        (model / "images.txt").write_text("".join(lines))
        points = [f"{number} {unit * x} 0 0 1 2 3 0.5 1 0\n" for number, x in ((7, -0.01), (90, 0.03))]
        (model / "points3D.txt").write_text("".join(points))
        return model
