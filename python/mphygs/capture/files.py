"""Files of a capture: paths that stay in its folder, arrays that are read without pickle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.archives import Head, open_archive
from mphygs.capture.document import Entry, written
from mphygs.capture.errors import fault

# Scenes of NeRF come in so many files of cameras.
SPLITS = ("train", "val", "test")


def path_inside(folder: Path, entry: Entry) -> Path:
    """The existing file or folder that `entry` names, relative to `folder` and, links followed, inside it."""
    text = entry.text()
    expected = "a path relative to capture.json that stays in its folder"
    if "\0" in text or Path(text).is_absolute() or text.startswith("\\") or text[1:2] == ":":
        raise entry.wrong(expected)
    root = folder.resolve()
    try:
        target = (root / text).resolve()
        exists = target.exists()
    except (OSError, RuntimeError) as error:
        raise entry.fault(f'"{text}" cannot be followed', expected) from error
    if target != root and root not in target.parents:
        raise entry.fault(f'"{text}" leads out of the folder', expected)
    if not exists:
        raise entry.fault(f'"{text}" does not exist', f"a file in {folder}")
    return folder / text


def file_inside(folder: Path, entry: Entry) -> Path:
    """As `path_inside`, for a file."""
    path = path_inside(folder, entry)
    if not path.is_file():
        raise entry.fault(f"{path} is not a file", "a file")
    return path


def views_inside(folder: Path, entry: Entry) -> Path:
    """As `path_inside`, for a folder of views: `transforms.json`, those of splits or a COLMAP model stands in
    it."""
    path = path_inside(folder, entry)
    if not path.is_dir():
        raise entry.fault(f"{path} is not a folder", "a folder of views")
    if not has_cameras(path):
        expected = "transforms.json, transforms_train.json or sparse/0 in it"
        raise entry.fault(f"{path} holds no cameras", expected)
    return path


def has_cameras(folder: Path) -> bool:
    """Whether a folder is one of views."""
    return bool(transforms_files(folder)) or colmap_folder(folder) is not None


def transforms_files(folder: Path) -> tuple[Path, ...]:
    """Where a folder of views tells its cameras: its transforms.json, or else the files of the splits that
    Blender's scenes of NeRF come in, as many as are there."""
    whole = folder / "transforms.json"
    found = (folder / f"transforms_{split}.json" for split in SPLITS)
    return (whole,) if whole.is_file() else tuple(path for path in found if path.is_file())


def colmap_folder(folder: Path) -> Path | None:
    """Where the COLMAP model of a folder of views stands, as it and its wrappers put it; None without one."""
    usual = folder / "sparse" / "0"
    places = [usual, folder / "sparse", *sorted((folder / "sparse").glob("[1-9]"))]
    places += [folder / "colmap" / "sparse" / "0", folder / "colmap" / "sparse", folder / "colmap"]
    found = [
        place for place in places if any((place / f"cameras.{kind}").is_file() for kind in ("bin", "txt"))
    ]
    return found[0] if found else usual if usual.is_dir() else None


@dataclass(frozen=True)
class Size:
    """How long an array must be along one axis. what: is counted there; why: so many."""

    count: int
    what: str
    why: str

    @classmethod
    def frames(cls, count: int) -> Size:
        """One entry for each frame of a sequence."""
        return cls(count, "frames", "as the sequence")


Shape = tuple[int | Size | None, ...]


def read_arrays(
    path: Path, shapes: Mapping[str, Shape | None], *, others: bool = False
) -> dict[str, np.ndarray]:
    """The named arrays of an .npz as float64; no others may be in it, unless `others`.

    None stands for any shape, and in a shape for any size above zero. NaN is allowed (not measured), infinity
    is not. Raises CaptureError naming the file and the array, of wrong sizes before anything is unpacked.
    """
    expected = f"an .npz with {', '.join(_described(name, shape) for name, shape in shapes.items())}"
    with open_archive(path, expected) as archive:
        for name in archive.names:
            if name not in shapes and not others:
                raise fault(f"{path}: {name}", "unknown array", expected)
        for name in shapes:
            if name not in archive.names:
                raise fault(str(path), f'array "{name}" is missing', expected)
        for name, shape in shapes.items():
            _check_head(archive.head(name), f"{path}: {name}", shape)
        found = {}
        for name, shape in shapes.items():
            array = archive.read(name, stated=shape is not None and None not in shape)
            found[name] = _finite(array, f"{path}: {name}")
        return found


def _described(name: str, shape: Shape | None) -> str:
    if shape is None:
        return f'"{name}"'
    return f'"{name}" {written([size if isinstance(size, int) else None for size in shape], "TM")}'


def _check_head(head: Head, where: str, shape: Shape | None) -> None:
    expected = "numbers"
    if shape is not None:
        free = [size if isinstance(size, int) else None for size in shape]
        expected = f"numbers of shape {written(free, 'TM')}"
    if head.dtype.kind not in "fiu" or head.dtype.itemsize > 8:
        raise fault(where, f"holds {head.dtype}", expected)
    if 0 in head.shape or (shape is not None and len(head.shape) != len(shape)):
        raise fault(where, f"has shape {written(head.shape)}", expected)
    for have, want in zip(head.shape, shape or (), strict=False):
        if isinstance(want, int) and have != want:
            raise fault(where, f"has shape {written(head.shape)}", expected)
    for have, want in zip(head.shape, shape or (), strict=False):
        if isinstance(want, Size) and have != want.count:
            raise fault(where, f"has {have} {want.what}", f"{want.count}, {want.why}")


def _finite(array: np.ndarray, where: str) -> np.ndarray:
    array = array.astype(np.float64)
    if np.isinf(array).any():
        index = [int(i) for i in np.argwhere(np.isinf(array))[0]]
        raise fault(where, f"is infinite at {index}", "numbers, NaN where nothing was measured")
    return array
