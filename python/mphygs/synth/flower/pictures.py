"""Folders of pictures: every one drawn once, those that are there already kept."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.cameras import Camera
from mphygs.capture.images import write_image
from mphygs.capture.transforms import write_transforms
from mphygs.synth.flower.drawing import Painter


@dataclass(frozen=True, eq=False)
class PictureView:
    """One picture to draw. frame: of the sequence, None at rest; vertices: (V, 3) [m]."""

    camera: Camera
    frame: int | None
    vertices: np.ndarray

    @property
    def name(self) -> str:
        """Of its file."""
        return f"{self.camera.name}.png" if self.frame is None else f"{self.camera.name}_{self.frame:04d}.png"


def write_pictures(
    folder: Path,
    painter: Painter,
    shown: Sequence[PictureView],
    *,
    noise: float,
    seed: int,
    tell: Callable[[int], object],
) -> None:
    """images/, masks/ and transforms.json of a folder of views.

    noise: standard deviation of the colours of a pixel, of a range of 1; tell: is called after every picture
    with the number of those that are done. A picture is there wholly or not at all.
    """
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True, exist_ok=True)
    for number, one in enumerate(shown):
        image, mask = folder / "images" / one.name, folder / "masks" / one.name
        if not (image.is_file() and mask.is_file()):
            drawing = painter.draw(one.camera, one.vertices)
            colour = drawing.colour
            if noise > 0.0:
                generator = np.random.default_rng([seed, 15, number])
                colour = colour + noise * generator.standard_normal(colour.shape)
            _write(mask, drawing.mask)
            _write(image, colour)
        tell(number + 1)
    write_transforms(
        folder / "transforms.json",
        [one.camera for one in shown],
        [f"images/{one.name}" for one in shown],
        [one.frame for one in shown],
    )


def _write(path: Path, values: np.ndarray) -> None:
    part = path.with_name(f"part-{path.name}")
    write_image(part, values)
    os.replace(part, path)
