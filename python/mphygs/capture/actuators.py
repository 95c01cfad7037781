"""Loads that are a channel of numbers in a file, one a frame: forces, pressures on a patch, tendons."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.interpolate import CubicSpline

from mphygs.capture.document import Entry
from mphygs.capture.errors import fault
from mphygs.capture.files import Size, file_inside, read_arrays
from mphygs.capture.holds import read_box, read_frames

UNKNOWN = ("gain", "delay")
_WIDEST = 1e12  # [m] of a place
_STRONGEST = {"force": 1e6, "pressure": 1e8, "tension": 1e6}  # [N], [Pa], [N]


@dataclass(frozen=True, eq=False)
class Actuator:
    """What is common to them. values: (T,) or (T, 3), of frame k at t = k / fps; name: key of its unknown
    numbers; it acts from start_frame to end_frame, None: to the end; unknown: some of UNKNOWN, which are
    fitted: it acts with gain * values(t - delay).

    array: name of the values in their file.
    """

    values: np.ndarray
    name: str
    start_frame: int = 0
    end_frame: int | None = None
    unknown: tuple[str, ...] = ()

    array: ClassVar[str]

    def course(self, times: np.ndarray, fps: float, derivative: int = 0) -> np.ndarray:
        """The values (n, ...) at times (n,) [s], or a derivative of them by time.

        A cubic spline (not-a-knot) goes through the frames; outside of them the first and the last hold.
        """
        frame = np.asarray(times, float) * fps
        last = len(self.values) - 1
        inside = np.clip(frame, 0.0, last)
        if last == 0:
            found = np.repeat(self.values if derivative == 0 else 0.0 * self.values, len(frame), axis=0)
        else:
            found = CubicSpline(np.arange(last + 1), self.values)(inside, derivative) * fps**derivative
        if derivative:
            found[inside != frame] = 0.0
        return found

    @property
    def places(self) -> dict[str, np.ndarray]:
        """What says where it acts [m], by its name here."""
        own = {f.name: getattr(self, f.name) for f in fields(self)[len(fields(Actuator)) :]}
        return {name: np.asarray(value) for name, value in own.items() if isinstance(value, np.ndarray)}

    def longer(self, factor: float) -> Actuator:
        """The same in lengths that are all larger."""
        return replace(self, **{name: factor * place for name, place in self.places.items()})


@dataclass(frozen=True, eq=False)
class Force(Actuator):
    """A force (T, 3) [N], shared by the material in box (2, 3) [m] together."""

    box: np.ndarray = field(kw_only=True)
    array: ClassVar[str] = "force"


@dataclass(frozen=True, eq=False)
class Pressure(Actuator):
    """A pressure (T,) [Pa] on a patch of the surface, which follows it; above zero it pushes inwards.

    part: name of the part whose surface it is, None: any; box: (2, 3) [m] that the patch lies in, at rest,
    None: all of the surface. Surfaces between parts and in holds are no part of it.
    """

    part: str | None = field(default=None, kw_only=True)
    box: np.ndarray | None = field(default=None, kw_only=True)
    array: ClassVar[str] = "pressure"


@dataclass(frozen=True, eq=False)
class Tendon(Actuator):
    """A tension (T,) [N] along path: (P, 3) points of the material at rest [m], without friction.

    anchor: (3,) [m], a point fixed in space that it runs to after the last one, None: it ends there.
    """

    path: np.ndarray = field(kw_only=True)
    anchor: np.ndarray | None = field(default=None, kw_only=True)
    array: ClassVar[str] = "tension"


def is_actuator(entry: Entry) -> bool:
    """Whether an element of `loads` has its numbers in a file."""
    table = entry.table()
    return any(key in table for key in ("pressure", "patch", "tendon", "tension")) or isinstance(
        table.get("force"), str
    )


def read_actuator(folder: Path, entry: Entry, frames: int, number: int) -> Actuator:
    """The actuator that element `number` of `loads` describes. Raises CaptureError."""
    kinds = [key for key in ("force", "pressure", "tendon") if entry.get(key)]
    if len(kinds) != 1:
        what = f"has {' and '.join(kinds)}" if kinds else "has neither force, pressure nor tendon"
        raise entry.fault(what, "exactly one of force, pressure, tendon")
    (kind,) = kinds
    where = {"force": ("box",), "pressure": ("patch",), "tendon": ("tension",)}[kind]
    more = ("anchor",) if kind == "tendon" else ()
    entry.check_keys(required=(*where, kind), optional=(*more, "name", "unknown", "from", "until"))
    name = entry["name"].name() if entry.get("name") else f"load{number}"
    start, end = read_frames(entry, frames, default=0)
    common = (name, start, end, _read_unknown(entry.get("unknown")))
    if kind == "force":
        values = _read_values(folder, entry["force"], Force, frames)
        return Force(values, *common, box=read_box(entry["box"]))
    if kind == "pressure":
        part, box = _read_patch(entry["patch"])
        values = _read_values(folder, entry["pressure"], Pressure, frames)
        return Pressure(values, *common, part=part, box=box)
    values = _read_values(folder, entry["tension"], Tendon, frames)
    if (values < 0.0).any():
        frame = int(np.argmax(values < 0.0))
        raise entry["tension"].fault(
            f"is {values[frame]:g} N in frame {frame}", "0 or more: a tendon does not push"
        )
    anchor = entry.get("anchor")
    end_point = None if anchor is None else anchor.array((3,), most=_WIDEST)
    return Tendon(values, *common, path=_read_path(entry["tendon"], end_point), anchor=end_point)


def _read_values(folder: Path, entry: Entry, kind: type[Actuator], frames: int) -> np.ndarray:
    path = file_inside(folder, entry)
    every = Size.frames(frames)
    shape = (every, 3) if kind is Force else (every,)
    values = read_arrays(path, {kind.array: shape})[kind.array]
    where = f"{path}: {kind.array}"
    unit = "Pa" if kind is Pressure else "N"
    if np.isnan(values).any():
        frame = int(np.argwhere(np.isnan(values))[0, 0])
        raise fault(where, f"is NaN in frame {frame}", f"a number [{unit}] in every frame")
    most = _STRONGEST[kind.array]
    if np.abs(values).max() > most:
        frame = int(np.argwhere(np.abs(values) > most)[0, 0])
        raise fault(where, f"is above {most:g} {unit} in frame {frame}", f"{unit}, at most {most:g}")
    return values


def _read_unknown(entry: Entry | None) -> tuple[str, ...]:
    if entry is None:
        return ()
    given = [item.choice(UNKNOWN) for item in entry.elements()]
    return tuple(name for name in UNKNOWN if name in given)


def _read_patch(entry: Entry) -> tuple[str | None, np.ndarray | None]:
    """A part's name, or {"part": name, "box": [[...], [...]]} with one of them or both."""
    if isinstance(entry.value, str):
        return entry.text(), None
    entry.check_keys(optional=("part", "box"))
    part, box = entry.get("part"), entry.get("box")
    if part is None and box is None:
        raise entry.fault("is empty", 'a part\'s name, or "part", "box" or both')
    return (None if part is None else part.text()), (None if box is None else read_box(box))


def _read_path(entry: Entry, anchor: np.ndarray | None) -> np.ndarray:
    points = entry.array((None, 3), most=_WIDEST)
    whole = points if anchor is None else np.concatenate([points, anchor[None]])
    if len(whole) < 2:
        raise entry.fault(f"has {len(points)} point", "two points or more, or an anchor besides")
    apart = np.linalg.norm(np.diff(whole, axis=0), axis=1)
    if (apart == 0.0).any():
        at = int(np.argmin(apart))
        raise entry.fault(f"points {at} and {at + 1} are the same", "points apart from each other")
    return points
