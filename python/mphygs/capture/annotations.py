"""Pixels that a person pointed at: the contact over time, and points seen at rest and in the first frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.cameras import Camera
from mphygs.capture.distortion import undistort_pixels
from mphygs.capture.document import Entry, read_document

CameraAt = Mapping[tuple[str, int], Camera]


@dataclass(frozen=True, eq=False)
class Correspondence:
    """One point of the object. rest: rest view -> pixel (2,), first: camera -> pixel (2,) in frame 0 [px].

    Pixels are those of the undistorted pictures, counted as everywhere (see capture/cameras.py).
    """

    rest: dict[str, np.ndarray]
    first: dict[str, np.ndarray]


def read_contact(path: Path, cameras: CameraAt) -> dict[str, dict[int, np.ndarray]]:
    """Camera -> frame -> pixel (2,) [px], undistorted, of the contact.json at `path`.

    The file is {camera: {frame: [u, v]}}. cameras: (name, frame) -> camera of the sequence. Raises
    CaptureError for one that is not among them and for pixels outside the picture.
    """
    names = sorted({name for name, _ in cameras})
    contact: dict[str, dict[int, np.ndarray]] = {}
    for name, track in read_document(path).children():
        if name not in names:
            raise track.fault(f'there is no camera "{name}"', f"one of {', '.join(names)}")
        contact[name] = {}
        for key, entry in track.children():
            if not key.isdigit() or (name, int(key)) not in cameras:
                raise entry.fault(f'camera "{name}" has no frame "{key}"', "a frame of the sequence")
            contact[name][int(key)] = _pixel(entry, cameras[name, int(key)])
    return contact


def read_correspondences(
    path: Path, rest: Mapping[str, Camera], cameras: CameraAt
) -> tuple[Correspondence, ...]:
    """The correspondences.json at `path`: [{"rest": {view: [u, v]}, "first": {camera: [u, v]}}].

    rest: the rest views by name; cameras: (name, frame) -> camera. Every point needs two views of each kind,
    else it fixes no place in space. Raises CaptureError for anything that cannot be used.
    """
    first = {name: camera for (name, frame), camera in cameras.items() if frame == 0}
    points = []
    for entry in read_document(path).elements():
        entry.check_keys(required=("rest", "first"))
        sides = {}
        for side, known in (("rest", rest), ("first", first)):
            sides[side] = {}
            for name, pixel in entry[side].children():
                if name not in known:
                    raise pixel.fault(f'there is no view "{name}"', f"one of {', '.join(sorted(known))}")
                sides[side][name] = _pixel(pixel, known[name])
            if len(sides[side]) < 2:
                raise entry[side].fault(f"has {len(sides[side])} pixels", "the point in at least two views")
        points.append(Correspondence(**sides))
    return tuple(points)


def _pixel(entry: Entry, camera: Camera) -> np.ndarray:
    pixel = entry.array((2,))
    if not ((pixel >= 0) & (pixel <= [camera.width, camera.height])).all():
        raise entry.fault(f"is {pixel.tolist()}", f"a pixel within {camera.width} x {camera.height}")
    try:
        return undistort_pixels(camera, pixel[None])[0]
    except ValueError as error:
        raise entry.fault(str(error), "a pixel that the lens shows, or another lens distortion") from error
