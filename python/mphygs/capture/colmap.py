"""Cameras and points from a COLMAP model, text or binary (colmap.github.io/format.html)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.cameras import Camera
from mphygs.capture.document import Entry
from mphygs.capture.errors import CaptureError, fault
from mphygs.capture.files import colmap_folder, file_inside
from mphygs.capture.rotation import matrix_from_quaternion
from mphygs.capture.shots import Shot

# COLMAP's number of a model, its parameters: f or fx fy, cx cy, then distortion in OpenCV's order
_MODELS = {
    "SIMPLE_PINHOLE": (0, 3),
    "PINHOLE": (1, 4),
    "SIMPLE_RADIAL": (2, 4),
    "RADIAL": (3, 5),
    "OPENCV": (4, 8),
    "FULL_OPENCV": (6, 12),
    "OPENCV_FISHEYE": (5, 8),
    "SIMPLE_RADIAL_FISHEYE": (8, 4),
    "RADIAL_FISHEYE": (9, 5),
    "THIN_PRISM_FISHEYE": (10, 12),
}
_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
# Where what a fisheye has stands among k1 k2 k3 k4 p1 p2 sx1 sy1; of THIN_PRISM p1 and p2 stand before k3.
_FISHEYES = {
    "OPENCV_FISHEYE": (0, 1, 2, 3),
    "SIMPLE_RADIAL_FISHEYE": (0,),
    "RADIAL_FISHEYE": (0, 1),
    "THIN_PRISM_FISHEYE": (0, 1, 4, 5, 2, 3, 6, 7),
}


@dataclass(frozen=True, eq=False)
class ColmapPoints:
    """positions: (P, 3), in the model's unit; colours: (P, 3), 0 to 1; numbers: (P,) by which the model knows
    them."""

    positions: np.ndarray
    colours: np.ndarray
    numbers: np.ndarray


@dataclass(frozen=True, eq=False)
class _Lens:
    width: int
    height: int
    focal: np.ndarray
    centre: np.ndarray
    distortion: np.ndarray
    fisheye: np.ndarray | None


def read_colmap(folder: Path) -> list[Shot]:
    """The pictures of the model in `folder`, in the order of their names; images are in images/.

    Lengths are in the model's unit, axes are the object frame's. A picture in a folder of its
    own, `images/<camera>/<frame>.png`, is frame <frame> of that camera; any other is a camera of its own.
    Raises CaptureError for anything that cannot be used.
    """
    model = colmap_folder(folder) or folder / "sparse" / "0"
    lenses = _read(model, "cameras", _cameras_of_text, _cameras_of_bytes)
    shots = []
    images = _read(model, "images", _images_of_text, _images_of_bytes)
    for name, lens, quaternion, translation in sorted(images, key=lambda image: image[0]):
        where = f"{model}: image {name}"
        if lens not in lenses:
            raise fault(where, f"is of camera {lens}, which the model has not", "a camera of the model")
        path = file_inside(folder, Entry(f"images/{name}", str(model), f"image {name}"))
        folder_name, number = path.parent.name, path.stem
        in_sequence = path.parent.parent == folder / "images" and number.isdigit()
        pose = np.eye(4)
        found = lenses[lens]
        try:
            if not np.linalg.norm(quaternion) > 1e-9:
                raise ValueError("its quaternion is zero")
            pose[:3, :3] = matrix_from_quaternion(quaternion)
            pose[:3, 3] = translation
            camera = Camera(
                name=folder_name if in_sequence else path.stem,
                width=found.width,
                height=found.height,
                focal=found.focal,
                centre=found.centre,
                camera_from_world=pose,
                distortion=found.distortion,
                fisheye=found.fisheye,
            )
        except ValueError as error:
            raise fault(where, str(error), "a camera") from error
        shots.append(Shot(camera, path, None, int(number) if in_sequence else None, where))
    if not shots:
        raise fault(str(model), "has no pictures", "at least one")
    return shots


def read_colmap_points(folder: Path) -> ColmapPoints:
    """The points of the model in `folder`/sparse/0. Raises CaptureError where they cannot be read."""
    model = colmap_folder(folder) or folder / "sparse" / "0"
    rows = _read(model, "points3D", _points_of_text, _points_of_bytes)
    table = np.array([row[1:] for row in rows], dtype=np.float64).reshape(-1, 6)
    if not np.isfinite(table).all():
        raise fault(f"{model}: points3D", "holds a number that is not finite", "numbers")
    numbers = np.array([row[0] for row in rows], dtype=np.uint64)
    return ColmapPoints(positions=table[:, :3], colours=table[:, 3:] / 255.0, numbers=numbers)


def _read(model: Path, name: str, of_text, of_bytes):  # noqa: ANN001, ANN202 (readers of either kind)
    """What `<name>.bin` or, without it, `<name>.txt` holds."""
    binary, text = model / f"{name}.bin", model / f"{name}.txt"
    path = binary if binary.is_file() else text
    if not path.is_file():
        raise fault(str(model), f"has neither {binary.name} nor {text.name}", "a COLMAP model")
    try:
        if path is binary:
            return of_bytes(_Bytes(path))
        return of_text(_lines(path), path)
    except CaptureError:
        raise
    except (ValueError, IndexError, struct.error, OverflowError) as error:
        raise fault(str(path), f"is damaged or truncated ({error})", f"COLMAP's {name}") from error


def _lines(path: Path) -> Iterator[list[str]]:
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            yield line.split()


class _Bytes:
    """A binary file read from its beginning, little-endian."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._data = path.read_bytes()
        self._at = 0

    def take(self, form: str) -> tuple:
        size = struct.calcsize("<" + form)
        values = struct.unpack_from("<" + form, self._data, self._at)
        self._at += size
        return values

    def skip(self, size: int) -> None:
        self._at += size
        if self._at > len(self._data):
            raise ValueError("it ends early")

    def text(self) -> str:
        end = self._data.index(b"\0", self._at)
        value = self._data[self._at : end].decode("utf-8")
        self._at = end + 1
        return value


def _lens(path: Path, model: str, width: int, height: int, parameters: np.ndarray) -> _Lens:
    focal_count = 1 if model in _ONE_FOCAL else 2
    focal = np.broadcast_to(parameters[:focal_count], 2)
    distortion, given = np.zeros(8), parameters[focal_count + 2 :]
    distortion[list(_FISHEYES.get(model, range(len(given))))] = given
    fisheye = distortion if model in _FISHEYES else None
    if fisheye is not None:
        distortion = np.zeros(8)
    if not np.isfinite(parameters).all():
        raise fault(str(path), "has a camera with numbers that are not finite", "numbers")
    return _Lens(width, height, focal, parameters[focal_count : focal_count + 2], distortion, fisheye)


def _unknown_model(path: Path, model: str | int) -> CaptureError:
    return fault(str(path), f"camera model {model}", f"one of {', '.join(_MODELS)} (undistort before)")


def _cameras_of_text(lines: Iterator[list[str]], path: Path) -> dict[int, _Lens]:
    lenses = {}
    for words in lines:
        if not words:
            continue
        model = words[1]
        if model not in _MODELS:
            raise _unknown_model(path, model)
        parameters = np.array([float(word) for word in words[4:]])
        if len(parameters) != _MODELS[model][1]:
            raise ValueError(f"camera {words[0]} has {len(parameters)} parameters")
        lenses[int(words[0])] = _lens(path, model, int(words[2]), int(words[3]), parameters)
    return lenses


def _cameras_of_bytes(data: _Bytes) -> dict[int, _Lens]:
    lenses = {}
    for _ in range(data.take("Q")[0]):
        number, model_number, width, height = data.take("iiQQ")
        model = next((name for name, (known, _) in _MODELS.items() if known == model_number), None)
        if model is None:
            raise _unknown_model(data.path, model_number)
        parameters = np.array(data.take(f"{_MODELS[model][1]}d"))
        lenses[number] = _lens(data.path, model, width, height, parameters)
    return lenses


_Image = tuple[str, int, np.ndarray, np.ndarray]


def _images_of_text(lines: Iterator[list[str]], path: Path) -> list[_Image]:
    """Every second line lists the points seen in the picture before it, and may be empty."""
    images = []
    for words in lines:
        if not words:
            continue
        if len(words) < 10:
            raise ValueError(f"a picture has {len(words)} entries, not 10")
        pose = np.array([float(word) for word in words[1:8]])
        images.append((" ".join(words[9:]), int(words[8]), pose[:4], pose[4:]))
        next(lines, None)
    return images


def _images_of_bytes(data: _Bytes) -> list[_Image]:
    images = []
    for _ in range(data.take("Q")[0]):
        numbers = data.take("I7dI")
        name = data.text()
        data.skip(24 * data.take("Q")[0])
        images.append((name, numbers[8], np.array(numbers[1:5]), np.array(numbers[5:8])))
    return images


def _points_of_text(lines: Iterator[list[str]], path: Path) -> list[list[float]]:
    """Number, place and colour of every point."""
    rows = [[int(words[0]), *(float(word) for word in words[1:7])] for words in lines if words]
    if any(len(row) != 7 for row in rows):
        raise ValueError("a point has no place or colour")
    return rows


def _points_of_bytes(data: _Bytes) -> list[list[float]]:
    rows = []
    for _ in range(data.take("Q")[0]):
        numbers = data.take("Q3d3Bd")
        data.skip(8 * data.take("Q")[0])
        rows.append(list(numbers[:7]))
    return rows
