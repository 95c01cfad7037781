"""What the stages of an image capture hand on: one folder a stage, whole files, made once.

A stage writes stage.json with what its result is made of and the result's digest, then the result. A result
of the same make is taken as it is; one that is not what stage.json speaks of, or stands there without it, is
the user's own, checked and taken; one of another make is made again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.errors import CaptureError, fault
from mphygs.capture.files import Size, read_arrays
from mphygs.capture.rotation import matrix_from_quaternion
from mphygs.capture.written import naming

STAGES, RECORD = "stages", "stage.json"
GAUSSIANS = f"{STAGES}/rest/gaussians.ply"
_UNIT = 1e-3  # how far from 1 the length of a quaternion may be


@dataclass(frozen=True, eq=False)
class Registered:
    """The object in frame 0. quaternion: (4,) wxyz and position: (3,) [m]: x = R X + p of the whole from
    rest; refined: (K, 3) [m], places of the Gaussians."""

    quaternion: np.ndarray
    position: np.ndarray
    refined: np.ndarray

    @property
    def rotation(self) -> np.ndarray:
        """R, (3, 3)."""
        return matrix_from_quaternion(self.quaternion)


@dataclass(frozen=True, eq=False)
class Tracks:
    """M Gaussians in T frames. rest: (M, 3) [m]; position: (T, M, 3) [m], NaN where not seen; quaternion:
    (T, M, 4), from rest, NaN where not seen; sigma: (M,) [m], standard deviation a coordinate; gaussian:
    (M,), rows of gaussians.ply."""

    rest: np.ndarray
    position: np.ndarray
    quaternion: np.ndarray
    sigma: np.ndarray
    gaussian: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """As they are written; places in single precision, which is finer than a thousandth of sigma."""
        small = {name: getattr(self, name).astype(np.float32) for name in ("position", "quaternion")}
        return {"rest": self.rest, "sigma": self.sigma, "gaussian": self.gaussian, **small}


@dataclass(frozen=True, eq=False)
class ContactHold:
    """position: (T, 3) [m], quaternion: (T, 4) wxyz, of the held points from rest, about the origin; box:
    (2, 3) [m], where they stand at rest."""

    position: np.ndarray
    quaternion: np.ndarray
    box: np.ndarray


@dataclass(frozen=True)
class MotionStage:
    """The folder of one stage. made_of: what its result depends on, as JSON."""

    folder: Path
    made_of: Mapping[str, object]

    def of(self, **more: object) -> MotionStage:
        """The stage made of something more."""
        return MotionStage(self.folder, {**self.made_of, **more})

    @property
    def _text(self) -> str:
        return json.dumps(self.made_of, indent=1, sort_keys=True) + "\n"

    def holds(self, name: str) -> bool:
        """Whether the result `name` is there and need not be made: of the same make, or the user's own."""
        if not (self.folder / name).is_file():
            return False
        return self.is_given(name) or self._record().get("made_of") == json.loads(self._text)

    def is_given(self, name: str) -> bool:
        """Whether the result `name` was put there by the user: it is not the one that was written."""
        path = self.folder / name
        return path.is_file() and self._record().get("result") != _digest(path.read_bytes())

    def write(self, name: str, arrays: Mapping[str, np.ndarray]) -> None:
        """The result and what it was made of; broken off at any moment, no result of another make is left
        that could be taken for the user's own."""
        part = write_part(self.folder / name, arrays)
        (self.folder / name).unlink(missing_ok=True)
        record = {"made_of": self.made_of, "result": _digest(part.read_bytes())}
        waiting = self.folder / f"part-{RECORD}"
        waiting.write_text(json.dumps(record, indent=1, sort_keys=True) + "\n", encoding="utf-8")
        os.replace(waiting, self.folder / RECORD)
        os.replace(part, self.folder / name)

    def _record(self) -> Mapping[str, object]:
        path = self.folder / RECORD
        try:
            record = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        except ValueError:  # no JSON: not written here
            return {}
        return record if isinstance(record, dict) else {}

    def partial(self, shapes: Mapping[str, tuple[int | None, ...]]) -> dict[str, np.ndarray] | None:
        """What a run that was broken off kept, None where there is nothing of the same make."""
        record, path = self.folder / f"partial-{RECORD}", self.folder / "partial.npz"
        if not (record.is_file() and path.is_file()) or record.read_text(encoding="utf-8") != self._text:
            return None
        return read_arrays(path, dict(shapes))

    def keep_partial(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Keep what is done so far."""
        record = self.folder / f"partial-{RECORD}"
        if not record.is_file() or record.read_text(encoding="utf-8") != self._text:
            (self.folder / "partial.npz").unlink(missing_ok=True)
            self.folder.mkdir(parents=True, exist_ok=True)
            record.write_text(self._text, encoding="utf-8")
        write_arrays(self.folder / "partial.npz", arrays)

    def drop_partial(self) -> None:
        """Forget it: the result is there."""
        for name in (f"partial-{RECORD}", "partial.npz"):
            (self.folder / name).unlink(missing_ok=True)


def write_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """An .npz, wholly or not at all."""
    os.replace(write_part(path, arrays), path)


def write_part(path: Path, arrays: Mapping[str, np.ndarray]) -> Path:
    """An .npz beside the place where it belongs, to be moved there once it is whole; makes the folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f"part-{path.name}")
    with naming(path):
        np.savez_compressed(part, **arrays)
    return part


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def digest_of_files(*paths: Path) -> str:
    """A hash of the content of files, and of names, sizes and texts of what stands in folders.

    Of pictures in a folder names and sizes are enough: reading them takes longer than some stages.
    """
    hashed = hashlib.sha256()
    for path in paths:
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        for file in files:
            if not file.is_file():
                continue
            hashed.update(f"{file.name}:{file.stat().st_size};".encode())
            if not path.is_dir() or file.suffix in (".json", ".txt", ".bin"):
                hashed.update(file.read_bytes())
    return hashed.hexdigest()


def read_registered(path: Path, *, gaussians: int) -> Registered:
    """pose.npz. Raises CaptureError, one line, for another number of Gaussians and what is no pose."""
    points = Size(gaussians, "points", "as gaussians.ply")
    arrays = read_arrays(path, {"quaternion": (4,), "position": (3,), "refined": (points, 3)})
    _check_finite(path, arrays)
    return Registered(_unit(path, arrays["quaternion"]), arrays["position"], arrays["refined"])


def read_tracks(path: Path, *, frames: int, gaussians: int | None = None) -> Tracks:
    """tracks.npz. Raises CaptureError, one line, for other frames than the sequence's, shapes that do not fit
    together, a sigma that is not above zero, and rows that gaussians.ply does not have."""
    shapes = {
        "rest": (None, 3),
        "position": (Size.frames(frames), None, 3),
        "quaternion": (Size.frames(frames), None, 4),
        "gaussian": (None,),
    }
    try:
        arrays = read_arrays(path, {**shapes, "sigma": ()})
    except CaptureError:  # one for each track, or at fault: then said with the shape for each
        arrays = read_arrays(path, {**shapes, "sigma": (None,)})
    else:
        arrays["sigma"] = np.full(len(arrays["rest"]), float(arrays["sigma"]))
    count = len(arrays["rest"])
    fitting = {
        "position": (frames, count, 3),
        "quaternion": (frames, count, 4),
        "sigma": (count,),
        "gaussian": (count,),
    }
    for name, shape in fitting.items():
        if arrays[name].shape != shape:
            raise fault(f"{path}: {name}", f"has shape {arrays[name].shape}", f"{shape}: frames and tracks")
    _check_finite(path, {name: arrays[name] for name in ("rest", "sigma", "gaussian")})
    if not (arrays["sigma"] > 0).all():
        raise fault(f"{path}: sigma", f"is {arrays['sigma'].min():g}", "standard deviations above 0 m")
    rows = arrays["gaussian"].astype(np.int64)
    if (
        (rows != arrays["gaussian"]).any()
        or rows.min() < 0
        or (gaussians is not None and rows.max() >= gaussians)
    ):
        last = "up" if gaussians is None else f"to {gaussians - 1}"
        raise fault(f"{path}: gaussian", "names rows that there are not", f"whole numbers from 0 {last}")
    return Tracks(arrays["rest"], arrays["position"], arrays["quaternion"], arrays["sigma"], rows)


def read_hold(path: Path, *, frames: int) -> ContactHold:
    """hold.npz. Raises CaptureError, one line, for other frames than the sequence's and what is no pose."""
    every = Size.frames(frames)
    arrays = read_arrays(path, {"position": (every, 3), "quaternion": (every, 4), "box": (2, 3)})
    _check_finite(path, arrays)
    if not (arrays["box"][0] < arrays["box"][1]).all():
        raise fault(f"{path}: box", f"is {arrays['box'].tolist()}", "a lower corner below an upper one")
    return ContactHold(arrays["position"], _unit(path, arrays["quaternion"]), arrays["box"])


def _check_finite(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            index = np.argwhere(~np.isfinite(array))[0].tolist()
            raise fault(f"{path}: {name}", f"is NaN at {index}", "numbers")


def _unit(path: Path, quaternion: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(quaternion, axis=-1, keepdims=True)
    worst = float(np.abs(length - 1).max())
    if worst > _UNIT:
        raise fault(f"{path}: quaternion", f"has a length {worst:.3g} off 1", "unit (w, x, y, z)")
    return quaternion / length
