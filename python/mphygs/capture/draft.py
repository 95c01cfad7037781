"""A capture.json for a folder of files: meshes, markers, motions of holds, folders of views."""

from __future__ import annotations

import csv
import json
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import ezc3d
import numpy as np

from mphygs.capture.c3d import read_c3d
from mphygs.capture.colmap import read_colmap
from mphygs.capture.errors import fault
from mphygs.capture.files import has_cameras, read_arrays, transforms_files
from mphygs.capture.markers import resting_position
from mphygs.capture.track_faults.tracks import ExaminedTracks
from mphygs.capture.track_faults.zero_gap_repair import repair_zero_gaps
from mphygs.capture.written import replace_arrays

MESHES = (".ply", ".stl", ".obj", ".off", ".glb")
MARKERS = (".c3d", ".npz", ".csv")
_HEADER = 100_000  # bytes of a .ply that are looked at


@dataclass(frozen=True)
class Files:
    """What a folder holds. motions: .npz of a hold's motion by the stem of the markers they belong to;
    rest_views: a folder of pictures at rest, views: folders of videos by name; gaussians: the object as a
    3DGS .ply."""

    meshes: tuple[Path, ...] = ()
    markers: tuple[Path, ...] = ()
    motions: Mapping[str, tuple[Path, ...]] = field(default_factory=dict)
    rest_views: Path | None = None
    gaussians: Path | None = None
    views: Mapping[str, Path] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class MarkerFile:
    """Markers of one file. position: (T, M, 3) [m], NaN where not seen; names: M, or none; fps: where the
    file says it; file: relative to the folder, of the capture format."""

    position: np.ndarray
    names: tuple[str, ...]
    fps: float | None
    file: str


def find_files(folder: Path) -> Files:
    """The files of a folder and of its subfolders with a transforms.json or a COLMAP model, by what is in
    them.

    Raises CaptureError for a camera file that cannot be read, or for a second folder of pictures at rest.
    """
    inside = sorted(path for path in folder.iterdir() if path.is_file())
    splats = [path for path in inside if path.suffix.lower() == ".ply" and _is_gaussians(path)]
    if len(splats) > 1:
        raise fault(str(splats[1]), f"is a second .ply of Gaussians beside {splats[0].name}", "one")
    meshes = tuple(p for p in inside if p.suffix.lower() in MESHES and p not in splats)
    markers, motions = [], []
    for path in inside:
        if path.suffix.lower() == ".npz":
            (motions if _is_motion(path) else markers).append(path)
        elif path.suffix.lower() in MARKERS:
            markers.append(path)
    owned: dict[str, tuple[Path, ...]] = {}
    for path in motions:
        owners = [m.stem for m in markers if path.stem.startswith(_plain(m.stem))]
        owner = max(owners, key=len, default=None)
        if owner is None:
            known = ", ".join(m.name for m in markers) or "markers"
            raise fault(str(path), "is a hold's motion of no marker file", f"a name that begins as {known}")
        owned[owner] = (*owned.get(owner, ()), path)
    rest, views = None, {}
    for path in sorted(path for path in folder.iterdir() if path.is_dir() and has_cameras(path)):
        if _is_sequence(path):
            views[path.name] = path
        elif rest is None:
            rest = path
        else:
            raise fault(str(path), f"is a second folder of pictures at rest beside {rest.name}", "one")
    return Files(meshes, tuple(markers), owned, rest, splats[0] if splats else None, views)


def _is_gaussians(path: Path) -> bool:
    """Whether a .ply holds the Gaussians of 3D Gaussian splatting, as its header says."""
    with path.open("rb") as stream:
        return b" f_dc_0" in stream.read(_HEADER).partition(b"end_header")[0]


def _plain(stem: str) -> str:
    """A marker file's stem without what only says that it holds markers."""
    return stem.removesuffix("_markers").removesuffix("-markers")


def _is_motion(path: Path) -> bool:
    try:
        with zipfile.ZipFile(path) as arrays:
            return "quaternion.npy" in arrays.namelist()
    except (OSError, zipfile.BadZipFile) as error:
        raise fault(str(path), f"cannot be read ({error})", "an .npz file") from error


def _is_sequence(folder: Path) -> bool:
    files = transforms_files(folder)
    if not files:
        return any(shot.frame is not None for shot in read_colmap(folder))
    found = False
    for path in files:
        try:
            frames = json.loads(path.read_text(encoding="utf-8"))["frames"]
            found |= any("camera" in frame or "frame" in frame for frame in frames)
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise fault(str(path), "cannot be read", "the cameras of a nerfstudio transforms.json") from error
    return found


def read_marker_file(folder: Path, path: Path, *, scale: float, fps: float | None) -> MarkerFile:
    """The markers of a file; of one that is no capture's, in metres, an .npz is written beside it.

    scale: unit of the file -> metre (a .c3d knows its own). Raises CaptureError.
    """
    if path.suffix.lower() == ".c3d":
        rate, count = _c3d_rate(path)
        position, names = read_c3d(path, fps=fps or rate, frames=count)
        return MarkerFile(position, names, fps or rate, path.name)
    if path.suffix.lower() == ".csv":
        position, names = read_csv(path)
    else:
        position, names = read_arrays(path, {"position": (None, None, 3)})["position"], ()
        if scale == 1.0:
            return MarkerFile(position, names, fps, path.name)
    target = folder / f"{path.stem}_in_metres.npz"
    if target.exists():
        raise fault(str(target), "is there already", f"it elsewhere: {path.name} is written to it in metres")
    replace_arrays(target, {"position": scale * position})
    return MarkerFile(scale * position, names, fps, target.name)


def _c3d_rate(path: Path) -> tuple[float, int]:
    try:
        content = ezc3d.c3d(str(path))
    except (RuntimeError, OSError, ValueError, IndexError, MemoryError, OverflowError) as error:
        raise fault(str(path), f"cannot be read ({error})", "a .c3d file") from error
    return float(content["header"]["points"]["frame_rate"]), int(content["data"]["points"].shape[2])


def read_csv(path: Path) -> tuple[np.ndarray, tuple[str, ...]]:
    """Tracks (T, M, 3) and names of a table: a row a frame, three columns a marker, empty where not seen.

    A first row of names is read ("tip_x" of marker tip); columns "time", "t" and "frame" are passed over.
    Raises CaptureError.
    """
    with path.open(newline="", encoding="utf-8-sig") as stream:
        rows = [row for row in csv.reader(stream) if any(cell.strip() for cell in row)]
    if not rows:
        raise fault(str(path), "is empty", "a row a frame, three columns a marker")
    head = rows[0] if any(_number(cell) is None for cell in rows[0]) else None
    body = rows[1:] if head is not None else rows
    used = [k for k in range(len(rows[0])) if head is None or not _is_time(head[k])]
    if len(used) % 3 or not used or not body:
        what = f"has {len(body)} rows of {len(used)} columns"
        raise fault(str(path), what, "a row a frame, three columns a marker")
    values = np.empty((len(body), len(used)))
    for number, row in enumerate(body):
        if len(row) != len(rows[0]):
            expected = f"{len(rows[0])}, as the first row"
            raise fault(f"{path}: frame {number}", f"has {len(row)} columns", expected)
        for column, k in enumerate(used):
            value = _number(row[k])
            if value is None:
                raise fault(f"{path}: frame {number}, column {k + 1}", f'is "{row[k].strip()}"', "a number")
            values[number, column] = value
    names = () if head is None else tuple(_marker_name(head[k]) for k in used[::3])
    return values.reshape(len(body), -1, 3), names if len(set(names)) == len(names) else ()


def _number(cell: str) -> float | None:
    """The number in a cell, NaN for an empty one, None for what is no number."""
    text = cell.strip()
    if not text or text.lower() == "nan":
        return float("nan")
    try:
        return float(text)
    except ValueError:
        return None


def _is_time(name: str) -> bool:
    return name.strip().lower().split("[")[0].split("(")[0].strip() in ("time", "t", "frame")


def _marker_name(column: str) -> str:
    name = column.strip()
    for ending in ("_x", ".x", "-x", " x", ":x"):
        if name.lower().endswith(ending):
            return name[: -len(ending)].strip()
    return name


def rest_of(path: Path, tracks: MarkerFile, release: int | None) -> np.ndarray:
    """(M, 3) places at rest [m] by the first frames. Raises CaptureError for a marker not seen in them."""
    rest = resting_position(_without_zeros(tracks.position, release), release)
    unseen = np.flatnonzero(~np.isfinite(rest).all(axis=1))
    if len(unseen):
        what = f"marker {unseen[0]} is not seen in the first frames"
        raise fault(str(path), what, "every marker at rest in them, or files without it")
    return rest


def _without_zeros(position: np.ndarray, release: int | None) -> np.ndarray:
    """Tracks without the zeros that a file has for gaps, as a capture's markers are read."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of a marker that is never seen
        middle = np.nan_to_num(np.nanmedian(position, axis=0))
    return repair_zero_gaps(ExaminedTracks(position, middle, 0.0, release)).position


def sequence_entry(
    name: str,
    tracks: MarkerFile | None,
    *,
    fps: float,
    frames: int,
    fit: int,
    held: Sequence[Mapping[str, object]],
    at: np.ndarray | None,
    sigma: float,
    release: int | None,
    views: str | None,
) -> dict[str, object]:
    """A sequence of capture.json. fit: frames that are fitted, the rest is kept for prediction."""
    entry: dict[str, object] = {
        "name": name,
        "fps": fps,
        "frames": frames,
        "fit": [0, fit],
        "predict": [fit, frames],
        "held": list(held),
    }
    if release is not None:
        entry["release"] = release
    if tracks is not None and at is not None:
        entry["markers"] = {"file": tracks.file, "at": at.tolist(), "sigma": sigma}
    if views is not None:
        entry["views"] = views
    return entry
