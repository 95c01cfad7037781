"""What is kept of a flower that is being made, so that one that was broken off goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.written import replace_arrays
from mphygs.synth.flower.true_motion import Settled

RECIPE = "recipe.json"


@dataclass(frozen=True)
class Checkpoint:
    """The folder of a capture; results of the simulation stand in its truth/."""

    folder: Path

    @classmethod
    def open(cls, folder: Path, made_of: dict[str, object]) -> Checkpoint:
        """The folder, empty before or begun with the same numbers. Raises ValueError for any other."""
        text = json.dumps(made_of, indent=1, sort_keys=True) + "\n"
        path = folder / "truth" / RECIPE
        if path.is_file():
            if path.read_text(encoding="utf-8") != text:
                raise ValueError(f"{folder}: holds a flower made of other options, expected an empty folder")
        elif folder.exists() and any(folder.iterdir()):
            raise ValueError(f"{folder}: holds something else, expected an empty folder")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return cls(folder)

    def settled(self, compute: Callable[[], Settled], prefix: str = "") -> Settled:
        """The flower at rest, from its file where there is one."""
        path = self.folder / "truth" / f"{prefix}settled.npz"
        if not path.is_file():
            new = compute()
            replace_arrays(path, vars(new))
        with np.load(path) as arrays:
            return Settled(arrays["vertices"], arrays["displacement"], float(arrays["speed"]))

    def moved(self, name: str, compute: Callable[[], tuple[np.ndarray, int]]) -> tuple[np.ndarray, int]:
        """Vertices (T, V, 3) [m] and substeps of one motion, from their file where there is one.

        The file holds float32, and so does what is returned.
        """
        path = self.folder / "truth" / f"{name}_surface.npz"
        if not path.is_file():
            vertices, substeps = compute()
            replace_arrays(path, {"vertices": vertices.astype(np.float32), "substeps": np.array(substeps)})
        with np.load(path) as arrays:
            return arrays["vertices"].astype(np.float64), int(arrays["substeps"])
