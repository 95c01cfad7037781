"""Meshes of rods and sheets, and captures of them held at one end, for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from mphygs.capture.format import Capture
from mphygs.capture.holds import Hold
from mphygs.capture.markers import Markers
from mphygs.capture.meshes import Part
from mphygs.capture.record import Known
from mphygs.capture.record import Sequence as Recording


def outward(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    assert mesh.is_watertight
    return np.asarray(vertices, float), np.asarray(faces if mesh.volume > 0 else faces[:, ::-1], np.int64)


def tube_mesh(line: np.ndarray, radius: float, sides: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A round rod along a plane curve. line: (n, 3) in the x-z plane [m]."""
    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    across = np.array([0.0, 1.0, 0.0])
    up = np.cross(tangent, across)
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * up[:, None]
    vertices = np.concatenate([(line[:, None] + radius * ring).reshape(-1, 3), line[[0, -1]]])
    count, faces = len(line), []
    for i in range(count - 1):
        for j in range(sides):
            a, b = i * sides + j, i * sides + (j + 1) % sides
            faces += [[a, b, a + sides], [b, b + sides, a + sides]]
    for j in range(sides):
        last, ahead = (count - 1) * sides, (j + 1) % sides
        faces += [[count * sides, ahead, j], [count * sides + 1, last + j, last + ahead]]
    return outward(vertices, np.array(faces))


def sheet_mesh(place: np.ndarray, thickness: float) -> tuple[np.ndarray, np.ndarray]:
    """A sheet about a middle surface. place: (a, b, 3) [m]; thickness [m]."""
    normal = np.cross(np.gradient(place, axis=0), np.gradient(place, axis=1))
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    shape, count = place.shape[:2], place.shape[0] * place.shape[1]
    middle, step = place.reshape(-1, 3), 0.5 * thickness * normal.reshape(-1, 3)
    number = np.arange(count).reshape(shape)
    a, b, c, d = (x.ravel() for x in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    top = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    rim = np.concatenate([number[:-1, 0], number[-1, :-1], number[:0:-1, -1], number[0, :0:-1]])
    ahead = np.roll(rim, -1)
    corner = (rim, rim + count, ahead + count, ahead)
    side = np.concatenate([np.stack([corner[0], corner[k], corner[k + 1]], axis=1) for k in (1, 2)])
    faces = np.concatenate([top, top[:, ::-1] + count, side])
    return outward(np.concatenate([middle + step, middle - step]), faces)


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
    u, w = np.linspace(0, 1, 33), np.linspace(-1, 1, 21)
    half = width / 2 * (0.25 + 0.75 * np.sin(np.pi * (0.9 * u + 0.05)) ** 0.7)
    s, y = np.meshgrid(u * length, w, indexing="ij")
    y = y * half[:, None]
    place = np.stack([np.sin(s * curl) / curl, y, (1 - np.cos(s * curl)) / curl + cup * y**2 / 2], axis=2)
    return Part("part0", *sheet_mesh(place, thickness), shape="shell")


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
