"""Measured 3D points: from .npz in the object frame, or from .c3d brought into it by a rigid fit at rest."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mphygs.capture.c3d import read_c3d
from mphygs.capture.document import Entry
from mphygs.capture.errors import fault
from mphygs.capture.files import Size, file_inside, read_arrays
from mphygs.capture.rotation import align_rigid
from mphygs.capture.track_faults import label_swap_repair, zero_gap_repair
from mphygs.capture.track_faults.track_repair import repaired_tracks
from mphygs.capture.track_faults.tracks import ExaminedTracks, Finding

SIGMAS = (1e-9, 1.0)  # [m]
FARTHEST = 1e4  # [m] of a place from the origin
_FEWEST_SEEN = 3  # markers, for a rigid fit
_FIRST_FRAMES = 5  # taken as rest where no release is given


@dataclass(frozen=True, eq=False)
class Markers:
    """Marker tracks of one sequence, in the object frame.

    position: (T, M, 3) [m], NaN where not measured; at: (M, 3) [m], the markers at rest; sigma: [m], one
    standard deviation of the noise per coordinate, as stated or as the tracks show; names: M labels, or none;
    findings: faults that were noticed in the file and put right; scatter: (M,) [m], each one's own standard
    deviation where the tracks show that they differ; offset: [m] of a coordinate of what is not known of the
    markers' places, a constant of each.
    Of tracks from video also spread: (M,) [m], each one's own standard deviation as stated; memory: what of
    a track's lasting error is carried to the next frame; lasting: that error's share of the variance, the
    rest is new in every frame.
    """

    position: np.ndarray
    at: np.ndarray
    sigma: float
    names: tuple[str, ...] = ()
    findings: tuple[Finding, ...] = ()
    scatter: np.ndarray | None = None
    offset: float = 0.0
    spread: np.ndarray | None = None
    memory: float = 0.0
    lasting: float = 1.0

    def __post_init__(self) -> None:
        if not (0.0 <= self.memory < 1.0 and 0.0 <= self.lasting <= 1.0):
            raise ValueError(f"memory {self.memory}, lasting {self.lasting}; expected 0 to 1, memory below 1")
        if self.spread is not None and (
            self.spread.shape != (len(self.at),)
            or not np.isfinite(self.spread).all()
            or self.spread.min() <= 0
        ):
            raise ValueError(f"spread: expected {len(self.at)} standard deviations above zero [m]")

    @property
    def stated(self) -> float:
        """Sigma as the capture states it [m], whatever its tracks showed when they were read."""
        told = (finding.numbers.get("stated") for finding in self.findings)
        return next((value for value in told if value), self.sigma)

    @property
    def each(self) -> np.ndarray:
        """(M,) [m] standard deviation of a coordinate of each marker."""
        for own in (self.spread, self.scatter):
            if own is not None:
                return np.asarray(own, float)
        return np.full(len(self.at), self.sigma)

    def at_rest(self, release: int | None) -> np.ndarray:
        """Median position (M, 3) [m] over the resting frames: those before release, or the first few."""
        return resting_position(self.position, release)


def resting_position(position: np.ndarray, release: int | None) -> np.ndarray:
    """Median over the resting frames of tracks (T, M, 3): (M, 3), NaN for a marker not seen in them.

    Where no release is stated they are the first few frames, or those from which on enough is seen to tell
    where the object is.
    """
    seen, begin = np.isfinite(position).all(axis=2), 0
    if not release and seen[:_FIRST_FRAMES].any(axis=0).sum() < _FEWEST_SEEN:
        begin = int(np.argmax(seen.sum(axis=1) >= _FEWEST_SEEN))
    rest = position[begin : release or begin + _FIRST_FRAMES]
    seen = np.isfinite(rest).any(axis=0)
    median = np.full(rest.shape[1:], np.nan)
    median[seen] = np.nanmedian(np.where(seen, rest, 0.0), axis=0)[seen]
    return median


def read_markers(
    folder: Path,
    entry: Entry,
    *,
    fps: float,
    frames: int,
    release: int | None,
    first: int | None = None,
    start: str | None = None,
) -> Markers:
    """The markers that `markers` describes; its `names` choose among the points of a .c3d.

    first: the file's frame that is frame 0, None for the file's first one; start: as the sequence states it.
    """
    entry.check_keys(required=("file", "at", "sigma"), optional=("names", "zero_is_missing"))
    at = entry["at"].array((None, 3), most=FARTHEST)
    sigma = entry["sigma"].within(*SIGMAS, "a standard deviation above zero [m]")
    names = _read_names(entry, len(at))
    given = entry.get("zero_is_missing")
    zeros = None if given is None else given.flag()
    path = file_inside(folder, entry["file"])
    suffix = path.suffix.lower()
    if suffix == ".npz":
        every = Size.frames(frames) if first is None else None
        shape = (every, Size(len(at), "markers", "one for each row of at"), 3)
        position = read_arrays(path, {"position": shape})["position"]
        if first is not None:
            position = _from_frame(path, position, first, frames)
        tracks = repaired_tracks(ExaminedTracks(position, at, sigma, release, zeros, begins=start))
    elif suffix == ".c3d":
        if start == "measured":
            what = f"{path.name} is told in the object frame by its rest, which the sequence does not show"
            raise entry["file"].fault(what, 'an .npz in the object frame beside "start": "measured"')
        position, labels = read_c3d(path, fps=fps, frames=frames, first=first or 0)
        if names:
            position = position[:, _columns(entry["names"], names, labels)]
        _check_count(path, position, at)
        names = names or labels
        # Zeros are seen in the file's own frame, the others in the object's.
        tracks = zero_gap_repair.repair_zero_gaps(
            ExaminedTracks(position, at, sigma, release, zeros, begins=start)
        )
        aligned = _to_object_frame(path, tracks.position, at, release)
        tracks = repaired_tracks(replace(tracks, position=aligned, zero_is_missing=False, raw=position))
        if any(finding.fault == label_swap_repair.FAULT for finding in tracks.findings):
            again = _to_object_frame(path, tracks.position, at, release)
            tracks = replace(tracks, position=again)
    else:
        raise entry["file"].wrong("an .npz or a .c3d file")
    if not np.isfinite(tracks.position).all(axis=2).any():
        what = "is NaN everywhere"
        if any(finding.fault == zero_gap_repair.FAULT for finding in tracks.findings):
            what = "is zero wherever it is measured"
        elif np.isfinite(tracks.position).any():
            what = "has no place with all of x, y and z"
        raise fault(f"{path}: position", what, "measured positions")
    return Markers(
        position=tracks.position,
        at=tracks.at,
        sigma=tracks.sigma,
        names=names,
        findings=tracks.findings,
        scatter=tracks.scatter,
        offset=tracks.lasting,
    )


def _from_frame(path: Path, position: np.ndarray, first: int, frames: int) -> np.ndarray:
    if len(position) < first + frames:
        expected = f"at least {first + frames}, frames {first} to {first + frames - 1}"
        raise fault(f"{path}: position", f"has {len(position)} frames", expected)
    return position[first : first + frames]


def _read_names(entry: Entry, count: int) -> tuple[str, ...]:
    given = entry.get("names")
    if given is None:
        return ()
    names = tuple(element.name() for element in given.elements())
    if len(names) != count:
        raise given.fault(f"has {len(names)} names", f"{count}, one for each row of at")
    for name in names:
        if names.count(name) > 1:
            raise given.fault(f'name "{name}" is given twice', "every name once")
    return names


def _columns(entry: Entry, names: tuple[str, ...], labels: tuple[str, ...]) -> list[int]:
    for name in names:
        if name not in labels:
            raise entry.fault(f'no point is labelled "{name}"', f"one of {', '.join(labels)}")
    return [labels.index(name) for name in names]


def _check_count(path: Path, position: np.ndarray, at: np.ndarray) -> None:
    if position.shape[1] != len(at):
        raise fault(
            f"{path}: position", f"has {position.shape[1]} markers", f"{len(at)}, one for each row of at"
        )


def _to_object_frame(path: Path, position: np.ndarray, at: np.ndarray, release: int | None) -> np.ndarray:
    """Tracks (T, M, 3) moved so that their resting position fits `at` (M, 3) best."""
    rest = resting_position(position, release)
    seen = np.isfinite(rest).all(axis=1)
    try:
        rotation, translation = align_rigid(rest[seen], at[seen])
    except ValueError as error:
        what = f"cannot be aligned to the object at rest ({str(error).split(';')[0]})"
        raise fault(f"{path}: position", what, "three markers seen at rest, not on one line") from error
    return position @ rotation.T + translation
