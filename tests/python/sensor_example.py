"""Bars that bear sensors, made in memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bar_capture import bar_capture
from mphygs.capture.format import Capture
from mphygs.capture.rotation import quaternion_from_rotation_vector
from mphygs.capture.sensors import Sensor

SIDE, HELD = 0.02, 0.006


def force_at(hold: int, frames: int, *, torque: bool = True) -> Sensor:
    """A force sensor that measured nothing yet."""
    count = 2 if torque else 1
    return Sensor("force", np.zeros((frames, count, 3)), np.full(count, 1.0), hold=hold)


def acceleration_at(at: np.ndarray, frames: int, *, gravity: bool = False) -> Sensor:
    """An accelerometer that measured nothing yet."""
    return Sensor("acceleration", np.zeros((frames, 1, 3)), np.ones(1), at=np.asarray(at), gravity=gravity)


def with_sensors(capture: Capture, *sensors: Sensor) -> Capture:
    """The capture with sensors in its only sequence."""
    return replace(capture, sequences=(replace(capture.sequences[0], sensors=sensors),))


def moved_bar(frames: int, **options: object) -> Capture:
    """A bar of two parts whose hold is shifted and turned, with a force sensor and an accelerometer."""
    capture = bar_capture(lengths=(0.03, 0.03), side=SIDE, held=HELD, frames=frames, **options)
    recording = capture.sequences[0]
    times = np.arange(frames) / recording.fps
    turn = 0.15 * np.sin(25.0 * times)[:, None] * [0.3, 1.0, -0.5]
    shift = 0.004 * np.sin(30.0 * times)[:, None] * [1.0, -0.6, 0.8]
    hold = replace(recording.held[0], position=shift, quaternion=quaternion_from_rotation_vector(turn))
    capture = replace(capture, sequences=(replace(recording, held=(hold,)),))
    tip = acceleration_at([0.055, 0.01, 0.02], frames, gravity=True)
    return with_sensors(capture, force_at(0, frames), tip)
