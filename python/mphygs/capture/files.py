"""Files of a capture: paths that stay in its folder, arrays that are read without pickle."""

from __future__ import annotations

import zipfile
import zlib
from pathlib import Path

import numpy as np

from mphygs.capture.document import Entry, written
from mphygs.capture.errors import CaptureError, fault


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
    """As `path_inside`, for a folder of views: `transforms.json` or a COLMAP model stands in it."""
    path = path_inside(folder, entry)
    if not path.is_dir():
        raise entry.fault(f"{path} is not a folder", "a folder of views")
    if not (path / "transforms.json").is_file() and not (path / "sparse" / "0").is_dir():
        raise entry.fault(f"{path} holds no cameras", "transforms.json or sparse/0 in it")
    return path


def read_arrays(path: Path, shapes: dict[str, tuple[int | None, ...]]) -> dict[str, np.ndarray]:
    """The named arrays of an .npz as float64; no others may be in it. None in a shape stands for any size.

    NaN is allowed (not measured), infinity is not. Raises CaptureError naming the file and the array.
    """
    names = ", ".join(f'"{name}" {written(shape, "TM")}' for name, shape in shapes.items())
    expected = f"an .npz with {names}"
    try:
        # opened here, because numpy leaves a file open that it fails to read
        with path.open("rb") as stream:
            archive = np.load(stream, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise fault(str(path), "is a single array", expected)
            for name in archive.files:
                if name not in shapes:
                    raise fault(f"{path}: {name}", "unknown array", expected)
            for name in shapes:
                if name not in archive.files:
                    raise fault(str(path), f'array "{name}" is missing', expected)
            return {name: _read_array(archive, path, name, shape) for name, shape in shapes.items()}
    except CaptureError:
        raise
    except (ValueError, OSError, EOFError, zipfile.BadZipFile) as error:
        raise fault(str(path), "is not an .npz file, or is truncated", expected) from error


def _read_array(
    archive: np.lib.npyio.NpzFile, path: Path, name: str, shape: tuple[int | None, ...]
) -> np.ndarray:
    where = f"{path}: {name}"
    expected = f"numbers of shape {written(shape, 'TM')}"
    try:
        array = archive[name]
    except ValueError as error:
        pickled = "allow_pickle" in str(error)
        what = "holds Python objects, which are not read" if pickled else "is truncated or damaged"
        raise fault(where, what, expected) from error
    except (OSError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError) as error:
        raise fault(where, "is truncated or damaged", expected) from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise fault(where, f"holds {getattr(array, 'dtype', 'raw bytes')}", expected)
    fits = array.ndim == len(shape) and all(
        want in (None, have) for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits or array.size == 0:
        raise fault(where, f"has shape {written(array.shape)}", expected)
    array = array.astype(np.float64)
    if np.isinf(array).any():
        index = tuple(int(i) for i in np.argwhere(np.isinf(array))[0])
        raise fault(where, f"is infinite at {list(index)}", "numbers, NaN where nothing was measured")
    return array
