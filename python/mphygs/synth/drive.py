"""What drives a bar whose hold stands still: a tendon beside its axis, or a pressure on one side of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mphygs.capture.actuators import Actuator, Pressure, Tendon
from mphygs.capture.motions import ramp
from mphygs.synth.shape import Shape

KINDS = ("tendon", "pressure")
BARS = ("bar", "two-part-bar")
# Of a bar's length, how far its tip goes; of its height, how far a tendon is from its axis.
BENT, BESIDE = 0.12, 0.3
# Places of the tendon's points, from the hold to the tip, in units of the bar's length.
ALONG = (0.0, 0.25, 0.5, 0.75, 0.95)
FREQUENCIES = (1.3, 2.1)  # [Hz], of the motion that is fitted and of the one that is not


@dataclass(frozen=True)
class Drive:
    """kind: of KINDS; gain: share of what the capture states that arrives; delay: how late it does [s]."""

    kind: str
    gain: float = 1.0
    delay: float = 0.0

    @classmethod
    def parse(cls, text: str) -> Drive:
        """From `kind:gain=0.8:delay=0.01`. Raises ValueError for anything else."""
        kind, *given = text.split(":")
        if kind not in KINDS:
            raise ValueError(f"drive '{kind}': expected one of {', '.join(KINDS)}")
        numbers = {}
        for item in given:
            key, _, value = item.partition("=")
            try:
                numbers[key] = float(value)
            except ValueError:
                raise ValueError(
                    f"drive '{text}': '{item}' is no number; expected gain=..., delay=..."
                ) from None
            if key not in ("gain", "delay"):
                raise ValueError(f"drive '{text}': unknown '{key}'; expected gain or delay")
        drive = cls(kind, **numbers)
        if not (0.0 < drive.gain <= 10.0 and 0.0 <= drive.delay <= 0.2):
            raise ValueError(f"drive '{text}': expected a gain above 0, at most 10, a delay of 0 to 0.2 s")
        return drive

    @property
    def unknown(self) -> tuple[str, ...]:
        """What of it the capture leaves to be found."""
        return (*(("gain",) if self.gain != 1.0 else ()), *(("delay",) if self.delay else ()))


def stated(
    drive: Drive, shape: Shape, youngs_modulus: Mapping[str, float], times: np.ndarray, number: int
) -> Actuator:
    """The actuator that a capture states, at frames that were taken at times (T,) [s] after the release.

    number: of the motion. Raises ValueError for an object that is no bar.
    """
    if shape.name not in BARS:
        raise ValueError(f"drive: not of the object '{shape.name}'; expected one of {', '.join(BARS)}")
    corners = np.concatenate([part.bounds for part in shape.parts])
    low, high = corners.min(0), corners.max(0)
    base = shape.hold[1, 0]
    length, width, height = high[0] - base, high[1] - low[1], high[2] - low[2]
    stiffness = min(youngs_modulus.values()) * width * height**3 / 12.0
    swing = 2.0 * np.pi * FREQUENCIES[number % 2] * times
    course = ramp(times / 0.3) * 0.5 * (1.0 - np.cos(swing))
    if drive.kind == "tendon":
        middle = 0.5 * (low + high)
        path = np.tile(middle, (len(ALONG), 1))
        path[:, 0] = base + np.array(ALONG) * length
        path[0, 0] = 0.5 * (low[0] + base)
        path[:, 2] += BESIDE * height
        # M L^2 / (2 E I) is what its end goes by.
        tension = 2.0 * BENT * stiffness / (BESIDE * height * length)
        return Tendon(tension * course, "tendon", unknown=drive.unknown, path=path)
    # q L^4 / (8 E I), q the pressure times the width.
    pressure = 8.0 * BENT * stiffness / (width * length**3)
    box = np.array([[base, low[1], high[2] - 1e-3 * height], [high[0], high[1], high[2] + 1e-3 * height]])
    return Pressure(pressure * course, "pressure", unknown=drive.unknown, box=box)


def arriving(drive: Drive, actuator: Actuator, fps: float) -> Actuator:
    """What acts where an actuator is stated: gain times its values, delayed."""
    frames = np.arange(len(actuator.values)) / fps
    return replace(actuator, values=drive.gain * actuator.course(frames - drive.delay, fps), unknown=())
