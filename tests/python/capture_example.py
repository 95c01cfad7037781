"""A small valid capture that the capture tests spoil in one place at a time."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest
import trimesh

from mphygs.capture.format import Capture, CaptureError, load_capture
from mphygs.capture.meshes import write_mesh
from mphygs.capture.rotation import quaternion_from_rotation_vector

FRAMES = 12
AT = np.array([[0.1, 0.0, 0.01], [0.05, 0.01, 0.0], [0.02, -0.01, 0.005], [0.09, 0.004, -0.01]])
NAMES = ["tip", "middle", "root", "under"]


def shared(*parts: str) -> Path:
    """A folder of recorded data kept beside the repository; the test is skipped where there is none."""
    path = Path(__file__).resolve().parents[2].parent.joinpath("shared", "data", *parts)
    if not path.exists():
        pytest.skip(f"the recorded data {'/'.join(parts)} is not beside the repository")
    return path


def bar(lower: tuple[float, ...], upper: tuple[float, ...]) -> trimesh.Trimesh:
    """A closed box from `lower` to `upper`."""
    return trimesh.creation.box(bounds=np.array([lower, upper]))


def tracks() -> np.ndarray:
    """Marker tracks (FRAMES, 4, 3): at rest for 6 frames, then sinking, one value missing."""
    fall = np.zeros((FRAMES, 1, 3))
    fall[6:, 0, 2] = -0.001 * np.arange(FRAMES - 6)
    position = AT + fall + 1e-4 * np.random.default_rng(0).standard_normal((FRAMES, 4, 3))
    position[4, 1] = np.nan
    return position


def write_c3d(
    path: Path, position: np.ndarray, *, labels: list[str], rate: float = 50.0, unit: str = "m"
) -> None:
    """A .c3d with points (T, M, 3) in `unit`; NaN is written as a point that was not seen."""
    content = ezc3d.c3d()
    content["parameters"]["POINT"]["RATE"]["value"] = [rate]
    content["parameters"]["POINT"]["LABELS"]["value"] = labels
    content["parameters"]["POINT"]["UNITS"]["value"] = [unit]
    points = np.ones((4, position.shape[1], position.shape[0]))
    points[:3] = position.transpose(2, 1, 0)
    content["data"]["points"] = points
    content.write(str(path))


class Example:
    """A capture folder with its document; `spoil` and `load` are what the tests do with it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        low, high = bar((0, -0.01, -0.01), (0.05, 0.01, 0.01)), bar((0.05, -0.01, -0.01), (0.1, 0.01, 0.01))
        write_mesh(folder / "low.ply", low.vertices, low.faces)
        high.apply_scale(1000.0)
        high.export(folder / "high.stl")
        angle = np.linspace(0, 0.4, FRAMES)[:, None] * [[0.0, 0.0, 1.0]]
        self.motion = {
            "position": np.linspace([0, 0, 0], [0.01, 0, 0], FRAMES) ** 2,
            "quaternion": quaternion_from_rotation_vector(angle),
        }
        self.tracks = tracks()
        np.savez(folder / "hold.npz", **self.motion)
        np.savez(folder / "markers.npz", position=self.tracks)
        self.document: dict[str, Any] = {
            "format": "mphygs-capture/1",
            "name": "example",
            "gravity": [0.0, 0, -9.81],
            "object": {
                "parts": [
                    {"name": "low", "mesh": "low.ply"},
                    {"name": "high", "mesh": "high.stl", "scale": 0.001},
                ],
                "rest": "stress-free",
                "known": {"density": {"low": 1000.0}, "poissons_ratio": 0.4, "mass": 0.04},
            },
            "sequences": [
                {
                    "name": "a",
                    "fps": 50.0,
                    "frames": FRAMES,
                    "fit": [0, 8],
                    "predict": [8, FRAMES],
                    "release": 6,
                    "held": [{"box": [[-1, -1, -1], [0.001, 1, 1]], "motion": "hold.npz"}],
                    "loads": [{"box": [[0.09, -1, -1], [1, 1, 1]], "force": [0, 0, -0.5], "from": 3}],
                    "markers": {"file": "markers.npz", "at": AT.tolist(), "sigma": 1e-4},
                },
                {
                    "name": "b.2",
                    "fps": 25,
                    "frames": 3,
                    "held": [{"box": [[-1] * 3, [0.01] * 3], "motion": "fixed"}],
                },
            ],
        }

    @property
    def sequence(self) -> dict[str, Any]:
        """The first sequence of the document."""
        return self.document["sequences"][0]

    def write(self) -> Path:
        """Write the document."""
        (self.folder / "capture.json").write_text(json.dumps(self.document))
        return self.folder

    def load(self) -> Capture:
        """Write the document and load the capture."""
        return load_capture(self.write())

    def complaint(self, spoil: Callable[[Example], object] | None = None) -> str:
        """The one line with which the spoilt capture is refused."""
        if spoil is not None:
            spoil(self)
        with pytest.raises(CaptureError) as caught:
            self.load()
        line = str(caught.value)
        assert "\n" not in line and "expected" in line and str(self.folder) in line
        return line
