"""Sanity of what instruments measured, beside the rest of a capture."""

from __future__ import annotations

import numpy as np

from mphygs.capture.errors import fault
from mphygs.capture.overlap import distance_to_box
from mphygs.capture.record import Capture, Sequence
from mphygs.capture.sensors import ACCELERATION, FORCE, Sensor

# Of the object's size and at least [m]: as far from it as an instrument on it may stand.
AWAY, AT_LEAST = 0.1, 5e-3
# Of gravity: so near to it at rest a reading includes it; frames of rest that show it.
NEAR, REST_FRAMES = 0.2, 3
ACCELERATIONS, WEIGHTS = 1e5, 1e5  # [m/s^2] and in weights of the object: more is another unit
_USUAL_DENSITY = 1000.0  # [kg/m^3]


def check_sensors(where: str, capture: Capture, sequence: Sequence) -> None:
    """Raise CaptureError at the first instrument of a sequence that contradicts the rest of it.

    where: file and key path of the sequence.
    """
    if sequence.sensors and sequence.markers is None and sequence.views is None:
        raise fault(f"{where}.sensors", "stand alone", "markers beside them, which tell where the object is")
    for index, sensor in enumerate(sequence.sensors):
        key = f"{where}.sensors[{index}]"
        if len(sensor.value) != sequence.frames:
            what = f"has {len(sensor.value)} frames"
            raise fault(f"{key}.file", what, f"{sequence.frames}, as the sequence")
        if sensor.kind == FORCE and not 0 <= sensor.hold < len(sequence.held):
            raise fault(f"{key}.hold", f"is {sensor.hold}", f"one of the {len(sequence.held)} that are held")
        if sensor.kind == ACCELERATION:
            _check_place(key, capture, sensor)
            _check_gravity(key, capture, sequence, sensor)
        _check_size(key, capture, sensor)


def _check_place(where: str, capture: Capture, sensor: Sensor) -> None:
    bounds, size = capture.bounds, capture.diagonal
    if bounds is None or size is None:
        return
    far = float(distance_to_box(sensor.at[None], bounds)[0])
    if far > max(AWAY * size, AT_LEAST):
        low, high = (", ".join(f"{value:.4g}" for value in corner) for corner in bounds)
        raise fault(
            f"{where}.at", f"lies {far:.3g} m from the object",
            f"a point in or on it, which spans ({low}) to ({high}) m",
        )  # fmt: skip


def _check_gravity(where: str, capture: Capture, sequence: Sequence, sensor: Sensor) -> None:
    """At rest an accelerometer reads gravity, upwards, and what has it taken off reads nothing."""
    strength = float(np.linalg.norm(capture.gravity))
    first = sensor.value[:REST_FRAMES, 0]
    first = first[np.isfinite(first).all(axis=1)]
    if strength == 0.0 or not len(first) or sequence.start == "measured":
        return
    reads = np.median(first, axis=0)
    if not sensor.gravity and np.linalg.norm(reads + capture.gravity) < NEAR * strength:
        raise fault(
            f"{where}.gravity", f"is false, but the sensor reads {np.linalg.norm(reads):.3g} m/s^2 at rest",
            "true, or an acceleration without gravity",
        )  # fmt: skip
    still = sequence.release is not None and sequence.release >= REST_FRAMES
    if sensor.gravity and still and np.linalg.norm(reads) < NEAR * strength:
        raise fault(
            f"{where}.gravity", f"is true, but the sensor reads {np.linalg.norm(reads):.3g} m/s^2 at rest",
            f"false, or {strength:.3g} m/s^2 upwards at rest, as an accelerometer reads",
        )  # fmt: skip


def _check_size(where: str, capture: Capture, sensor: Sensor) -> None:
    """What no instrument on the object reads is in another unit."""
    most, unit = ACCELERATIONS, "m/s^2"
    if sensor.kind == FORCE:
        if not capture.parts:
            return
        known = capture.known
        mass = known.mass or sum(known.density.get(p.name, _USUAL_DENSITY) * p.volume for p in capture.parts)
        most, unit = WEIGHTS * 9.81 * mass, "N"
    with np.errstate(invalid="ignore"):
        largest = float(np.nanmax(np.abs(sensor.value[:, 0])))
    if largest > most:
        raise fault(f"{where}.file", f"reads up to {largest:.3g} {unit}", f"at most {most:.3g} {unit}")
