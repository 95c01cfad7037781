"""The instruments that a made capture has beside its markers, and their noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from mphygs.capture.record import Sequence as Recording
from mphygs.capture.sensors import ACCELERATION, FORCE, Sensor
from mphygs.simulate.instruments import compared_frames
from mphygs.synth.shape import Shape

TORQUE = "torque"
KINDS = (FORCE, TORQUE, ACCELERATION)
# Usual noise: of a force in weights of the object, of a torque in these times its size, of an acceleration
# as small chips have it [m/s^2].
FORCE_NOISE, ACCELERATION_NOISE = 0.005, 0.05


def parse_sensors(texts: Sequence[str], shape: Shape, weight: float) -> dict[str, float]:
    """Kind -> standard deviation of a coordinate, from `kind` or `kind:sigma=value` each.

    force and torque: what the hold exerts; acceleration: of the object's tip, gravity included. weight: of
    the object [N]. Raises ValueError for unknown kinds, a torque without the force, and numbers that are not
    above zero.
    """
    size = float(np.linalg.norm(np.ptp(np.concatenate([part.bounds for part in shape.parts]), axis=0)))
    force = FORCE_NOISE * weight
    usual = {FORCE: force, TORQUE: force * size, ACCELERATION: ACCELERATION_NOISE}
    found: dict[str, float] = {}
    for text in texts:
        kind, colon, rest = text.partition(":")
        if kind not in KINDS:
            raise ValueError(f"sensor '{kind}': expected some of {', '.join(KINDS)}")
        if kind in found:
            raise ValueError(f"sensor '{kind}' is given twice, expected once")
        found[kind] = _sigma(text, rest) if colon else usual[kind]
    if TORQUE in found and FORCE not in found:
        raise ValueError("sensor 'torque': expected the force beside it")
    return found


def _sigma(text: str, pair: str) -> float:
    key, equals, value = pair.partition("=")
    try:
        number = float(value)
    except ValueError:
        number = 0.0
    if key != "sigma" or not equals or not 0.0 < number < np.inf:
        raise ValueError(f"sensor '{text}': expected kind:sigma=NUMBER, above zero")
    return number


def empty_sensors(sigmas: Mapping[str, float], shape: Shape, frames: int) -> tuple[Sensor, ...]:
    """The instruments before anything was measured."""
    out = []
    if FORCE in sigmas:
        sigma = np.array([sigmas[kind] for kind in (FORCE, TORQUE) if kind in sigmas])
        out.append(Sensor(FORCE, np.full((frames, len(sigma), 3), np.nan), sigma, hold=0))
    if ACCELERATION in sigmas:
        nothing, sigma = np.full((frames, 1, 3), np.nan), np.array([sigmas[ACCELERATION]])
        out.append(Sensor(ACCELERATION, nothing, sigma, at=shape.tip, gravity=True))
    return tuple(out)


def measured_sensors(
    recording: Recording,
    readings: Sequence[np.ndarray],
    offset: float,
    generator: np.random.Generator,
) -> tuple[Sensor, ...]:
    """The instruments of a recording with what they measured.

    readings: true ones, (T, V, 3) from frame 0 on, as many frames or more; offset: how much later than stated
    the frames were taken [s]; generator: of the noise.
    """
    out = []
    for sensor, true in zip(recording.sensors, readings, strict=True):
        value = np.array(true[: recording.frames])
        if offset:
            told = np.isfinite(true).all(axis=(1, 2))
            times = np.arange(len(true)) / recording.fps
            value = CubicSpline(times[told], true[told])(times[: recording.frames] + offset)
        value = value + sensor.sigma[:, None] * generator.standard_normal(value.shape)
        value[~compared_frames(recording, sensor)] = np.nan
        out.append(replace(sensor, value=value))
    return tuple(out)
