"""What instruments measured beside the markers: forces at a hold, the acceleration of a point."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.archives import open_archive
from mphygs.capture.document import Entry
from mphygs.capture.errors import fault
from mphygs.capture.files import Size, file_inside, read_arrays

FORCE, ACCELERATION = "force", "acceleration"
KINDS = (FORCE, ACCELERATION)
UNITS = {FORCE: "N", "torque": "N m", ACCELERATION: "m/s^2"}
SIGMAS = (1e-12, 1e9)
_FARTHEST = 1e4  # [m] of a place from the origin


@dataclass(frozen=True, eq=False)
class Sensor:
    """Measurements of one instrument in all frames of a sequence, along the axes of the object frame.

    kind: "force" or "acceleration"; value: (T, V, 3), NaN where not measured. A force: V = 1, what the hold
    of number `hold` exerts on the object [N], and where V = 2 also its torque [N m] about the centre of the
    hold's box, which moves with the hold. An acceleration [m/s^2]: of the material point that is at `at`
    (3,) [m] at rest; gravity: whether it is told as an accelerometer does, less gravity (9.81 upwards at
    rest). sigma: (V,) of one coordinate, NaN where none is stated.
    """

    kind: str
    value: np.ndarray
    sigma: np.ndarray
    hold: int | None = None
    at: np.ndarray | None = None
    gravity: bool = False

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"sensor '{self.kind}': expected one of {', '.join(KINDS)}")
        most = 2 if self.kind == FORCE else 1
        shape = self.value.shape
        if len(shape) != 3 or not 1 <= shape[1] <= most or shape[2] != 3 or self.sigma.shape != shape[1:2]:
            raise ValueError(
                f"sensor '{self.kind}': value of shape {shape}, sigma of {self.sigma.shape}; "
                f"expected (T, V, 3) and (V,) with V at most {most}"
            )
        if (self.hold is None) == (self.kind == FORCE) or (self.at is None) == (self.kind == ACCELERATION):
            raise ValueError(f"sensor '{self.kind}': expected a hold of a force, a place of an acceleration")
        if not (np.isnan(self.sigma) | (self.sigma > 0.0)).all():
            raise ValueError(f"sensor '{self.kind}': sigma {self.sigma}; expected above zero, NaN if unknown")

    @property
    def quantities(self) -> tuple[str, ...]:
        """What its V vectors are: force and torque, or acceleration."""
        return (FORCE, "torque")[: self.value.shape[1]] if self.kind == FORCE else (ACCELERATION,)

    @property
    def label(self) -> str:
        """What it is called where results are told."""
        if self.kind == FORCE:
            return f"force at hold {self.hold}"
        return f"acceleration at ({', '.join(f'{x:.4g}' for x in self.at)})"


def read_sensors(folder: Path, entry: Entry, frames: int, hold_count: int) -> tuple[Sensor, ...]:
    """The instruments that `sensors` lists.

    Raises CaptureError for an unknown kind, a hold that is not there, and files that do not fit.
    """
    return tuple(_read_sensor(folder, item, frames, hold_count) for item in entry.elements())


def _read_sensor(folder: Path, entry: Entry, frames: int, hold_count: int) -> Sensor:
    entry.check_keys(
        required=("kind", "file"), optional=("hold", "at", "gravity", "sigma", "torque_sigma")
    )
    kind = entry["kind"].choice(KINDS)
    own = ("hold", "torque_sigma") if kind == FORCE else ("at", "gravity")
    for key in ("hold", "torque_sigma", "at", "gravity"):
        if key not in own and entry.get(key):
            raise entry[key].fault(f'stands at a sensor of kind "{kind}"', f"of these {' and '.join(own)}")
    if kind == FORCE:
        return _read_force(folder, entry, frames, hold_count)
    at = entry["at"].array((3,), most=_FARTHEST)
    path = file_inside(folder, entry["file"])
    value = read_arrays(path, {"acceleration": (Size.frames(frames), 3)})["acceleration"]
    _check_measured(path, "acceleration", value)
    given = entry.get("gravity")
    gravity = given is not None and given.flag()
    return Sensor(kind, value[:, None], np.array([_sigma(entry, "sigma")]), at=at, gravity=gravity)


def _read_force(folder: Path, entry: Entry, frames: int, hold_count: int) -> Sensor:
    hold = entry["hold"].integer()
    if not 0 <= hold < hold_count:
        expected = f"one of held, 0 to {hold_count - 1}" if hold_count else "a hold, of which there is none"
        raise entry["hold"].wrong(expected)
    path = file_inside(folder, entry["file"])
    with open_archive(path, 'an .npz with "force" (T, 3)') as archive:
        names = ("force", "torque") if "torque" in archive.names else ("force",)
    arrays = read_arrays(path, {name: (Size.frames(frames), 3) for name in names})
    for name in names:
        _check_measured(path, name, arrays[name])
    if entry.get("torque_sigma") and len(names) < 2:
        raise entry["torque_sigma"].fault(f"stands beside {path.name}", "a torque in that file")
    sigma = [_sigma(entry, key) for key in ("sigma", "torque_sigma")[: len(names)]]
    return Sensor(FORCE, np.stack([arrays[name] for name in names], axis=1), np.array(sigma), hold=hold)


def _sigma(entry: Entry, key: str) -> float:
    """The standard deviation that is stated, NaN where none is."""
    given = entry.get(key)
    return np.nan if given is None else given.within(*SIGMAS, "a standard deviation above zero")


def _check_measured(path: Path, name: str, value: np.ndarray) -> None:
    if not np.isfinite(value).all(axis=1).any():
        raise fault(f"{path}: {name}", "is NaN everywhere", "measured values")
