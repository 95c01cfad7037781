"""Pictures and cameras of a folder of views, whatever program wrote them, in metres."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from mphygs.capture.cameras import Camera
from mphygs.capture.colmap import ColmapPoints, read_colmap, read_colmap_points
from mphygs.capture.document import Entry
from mphygs.capture.files import colmap_folder, transforms_files
from mphygs.capture.record import Capture
from mphygs.capture.shots import Shot
from mphygs.capture.transforms import read_transforms

SCALES = (1e-9, 1e9)  # metres per unit of a reconstruction
# Of the largest coordinate: places nearer than this are one.
_SHORTEST = 1e-9


def read_shots(folder: Path, scale: float = 1.0) -> list[Shot]:
    """The pictures of a folder of views, by its transforms.json, those of its splits or its COLMAP model.

    scale: metres per unit of the reconstruction. Raises CaptureError for anything that cannot be used.
    """
    files = transforms_files(folder)
    shots = [shot for file in files for shot in read_transforms(file)] if files else read_colmap(folder)
    return [replace(shot, camera=_scaled(shot.camera, scale)) for shot in shots]


def read_points(folder: Path, scale: float = 1.0) -> ColmapPoints | None:
    """The points that a reconstruction found beside its cameras [m]; None where it is no COLMAP model."""
    if transforms_files(folder) or colmap_folder(folder) is None:
        return None
    points = read_colmap_points(folder)
    return replace(points, positions=points.positions * scale)


def unit_remarks(capture: Capture) -> list[str]:
    """What is to be said of the unit of a capture's views where nothing states it: a COLMAP model is in one
    of its own."""
    views = [("object", capture.views, capture.views_scale)]
    views += [(recording.name, recording.views, recording.views_scale) for recording in capture.sequences]
    return [
        f"{name}: lengths of its COLMAP model are taken for metres; if they are in a unit of its own, as "
        "usual, state scale or known_length beside views"
        for name, folder, scale in views
        if folder is not None and scale == 1.0 and not transforms_files(folder)
    ]


def _scaled(camera: Camera, scale: float) -> Camera:
    pose = camera.camera_from_world.copy()
    pose[:3, 3] *= scale
    return replace(camera, camera_from_world=pose)


def named_apart(folder: Path, shots: list[Shot]) -> list[Shot]:
    """The shots of rest views, those of files of one name in several folders named with their folders."""
    count = Counter(shot.camera.name for shot in shots)
    named = []
    for shot in shots:
        name = shot.camera.name
        if count[name] > 1 and (name == shot.image.stem or shot.frame is not None):
            parts = shot.image.relative_to(folder).with_suffix("").parts
            name = "-".join(parts[parts[0] == "images" :])
        named.append(replace(shot, camera=replace(shot.camera, name=name)))
    return named


def read_scale(entry: Entry, folder: Path | None) -> float:
    """Metres per unit of the views in a folder, or of Gaussians (None), as `scale` or `known_length` beside
    them say; 1 without.

    known_length: [[a, b], metres], the distance of two places of the reconstruction: a picture by its name
    (where its camera stood), a point of a COLMAP model by its number, or [x, y, z] in the unit of the
    reconstruction, which is all that Gaussians have. Raises CaptureError.
    """
    scale, length = entry.get("scale"), entry.get("known_length")
    if scale is not None and length is not None:
        raise length.fault("stands beside scale", "one of them")
    if scale is not None:
        return scale.within(*SCALES, "metres per unit of the reconstruction")
    if length is None:
        return 1.0
    expected = '[[a, b], metres], of two pictures "name", points of the model 123, or places [x, y, z]'
    items = length.elements()
    ends = items[0].elements() if len(items) == 2 else []
    if len(ends) != 2:
        raise length.fault("is no length between two places", expected)
    metres = items[1].within(1e-6, 1e6, "a length above zero [m]")
    a, b = (_place(end, folder, expected) for end in ends)
    apart = float(np.linalg.norm(a - b))
    if apart <= _SHORTEST * max(np.abs(a).max(), np.abs(b).max()) or not np.isfinite(metres / apart):
        raise items[0].fault("names one place twice", "two that are apart")
    if not SCALES[0] <= metres / apart <= SCALES[1]:
        raise length.fault(f"makes {metres / apart:.3g} metres of a unit", f"{SCALES[0]:g} to {SCALES[1]:g}")
    return metres / apart


def _place(entry: Entry, folder: Path | None, expected: str) -> np.ndarray:
    """A place (3,) of a reconstruction, in its own unit."""
    if isinstance(entry.value, list):
        return entry.array((3,), most=1e12)
    if folder is None:
        raise entry.wrong("[x, y, z]: Gaussians have no pictures and no numbers")
    if isinstance(entry.value, str):
        return _stand(entry, folder)
    if isinstance(entry.value, bool) or not isinstance(entry.value, int):
        raise entry.wrong(expected)
    points = read_points(folder)
    if points is None:
        raise entry.wrong("the name of a picture: a transforms.json has no points")
    found = np.flatnonzero(points.numbers == entry.value)
    if len(found) != 1:
        count = len(points.numbers)
        raise entry.fault(f"is {entry.value}, which is no point of the model", f"one of its {count} points")
    return points.positions[found[0]]


def _stand(entry: Entry, folder: Path) -> np.ndarray:
    """Where the camera of a picture stood, by its name or that of its file."""
    name = entry.name()
    plain = read_shots(folder)
    apart = named_apart(folder, plain)
    found = {
        tuple(shot.camera.position): shot
        for shot, other in zip(plain, apart, strict=True)
        if name in (shot.camera.name, other.camera.name, *_names(folder, shot.image))
    }
    if len(found) != 1:
        raise entry.fault(_of_many(name, len(found)), f"a picture of {folder.name} by its name")
    return next(iter(found.values())).camera.position


def _of_many(name: str, count: int) -> str:
    return f'"{name}" is no picture' if not count else f'"{name}" is taken from {count} places'


def _names(folder: Path, image: Path) -> tuple[str, ...]:
    try:
        inside = image.relative_to(folder)
    except ValueError:
        inside = Path(image.name)
    parts = inside.parts
    return (image.name, image.stem, inside.as_posix(), "/".join(parts[parts[0] == "images" :]))
