"""Meshes of rods and sheets, and captures of them held at one end, for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.holds import Hold
from mphygs.capture.markers import Markers
from mphygs.capture.meshes import Part
from mphygs.capture.record import Known
from mphygs.capture.record import Sequence as Recording
from mphygs.synth.thin_shapes import petal_places, sheet_mesh, tube_mesh


def rod(
    length: float = 0.1,
    radius: float = 0.0015,
    *,
    held: float = 0.01,
    bend: float = 0.0,
    sides: int = 24,
) -> Part:
    """Along x from -held to length, bent upwards with a curvature [1/m]."""
    s = np.linspace(-held, length, max(int(round((length + held) / 0.002)), 8) + 1)
    along = np.maximum(s, 0.0)
    x = s if bend == 0.0 else np.minimum(s, 0.0) + np.sin(along * bend) / bend
    z = 0.0 * s if bend == 0.0 else (1.0 - np.cos(along * bend)) / bend
    return Part("part0", *tube_mesh(np.stack([x, 0.0 * s, z], axis=1), radius, sides), shape="rod")


def strip(
    length: float = 0.1,
    width: float = 0.02,
    thickness: float = 3e-4,
    *,
    held: float = 0.01,
    shape: str = "shell",
) -> Part:
    """A flat strip along x from -held to length."""
    x, y = np.linspace(-held, length, 45), np.linspace(-width / 2, width / 2, 9)
    place = np.stack([*np.meshgrid(x, y, indexing="ij"), np.zeros((45, 9))], axis=2)
    return Part("part0", *sheet_mesh(place, thickness), shape=shape)


def leaf(
    length: float = 0.04,
    width: float = 0.025,
    thickness: float = 3e-4,
    curl: float = 20.0,
    cup: float = 20.0,
) -> Part:
    """A pointed leaf from x = 0, curled up along x and cupped across [1/m]."""
    return Part("part0", *sheet_mesh(petal_places(length, width, curl, cup), thickness), shape="shell")


def held_capture(
    parts: Sequence[Part],
    *,
    box: Sequence[Sequence[float]] = ((-1.0, -1.0, -1.0), (0.0, 1.0, 1.0)),
    frames: int = 3,
    fps: float = 60.0,
    gravity: Sequence[float] = (0.0, 0.0, 0.0),
    markers: np.ndarray | None = None,
    motion: np.ndarray | None = None,
    rest: str = "stress-free",
    fit: tuple[int, int] = (0, 0),
) -> Capture:
    """Parts gripped in a box. motion: (T, 3) of the hold [m]."""
    if markers is None:
        ends = [part.vertices[part.vertices[:, 0].argmax()] for part in parts]
        markers = np.array(ends)
    turn = None if motion is None else np.tile([1.0, 0.0, 0.0, 0.0], (frames, 1))
    position = np.tile(markers, (frames, 1, 1))
    recording = Recording(
        "a", fps, frames, fit=fit, held=(Hold(np.array(box, float), motion, turn),),
        markers=Markers(position, markers, 1e-4),
    )  # fmt: skip
    return Capture("thin", Path("."), np.array(gravity, float), tuple(parts), rest, Known(), (recording,))
