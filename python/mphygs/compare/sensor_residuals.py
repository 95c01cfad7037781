"""What instruments measured, with its noise, beside what a model says that they read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import comb

import numpy as np

from mphygs.capture.record import Sequence as Recording
from mphygs.capture.sensors import UNITS, Sensor
from mphygs.compare.whitening import NoiseModel, Whitener
from mphygs.simulate.instruments import Reading, compared_frames

# Orders of the differences that tell noise from motion: motion only adds to what they show of it.
ORDERS = (2, 4, 6)
# Without a stated sigma no less of a signal's own size: what was computed has no noise that could be seen.
LEAST = 1e-3


@dataclass(frozen=True, eq=False)
class SensorObservation:
    """One instrument's measurement.

    label: its name; quantities: of its V vectors; value: (T, V, 3), NaN where it was not measured or no model
    tells it; noise: of one coordinate, by vector; grid: (V,) standard deviation of what a simulation gets
    wrong of it, which counts as noise as well. Markers hardly need that: forces and accelerations are mostly
    of fast modes of motion, which grids have worst.
    """

    label: str
    quantities: tuple[str, ...]
    value: np.ndarray
    noise: NoiseModel
    grid: np.ndarray | float = 0.0
    _whiteners: dict = field(default_factory=dict, init=False, repr=False)

    @property
    def sigma(self) -> np.ndarray:
        """(V,) standard deviation of a coordinate."""
        return np.broadcast_to(self.noise.sigma, self.value.shape[1:2])

    @property
    def units(self) -> tuple[str, ...]:
        """Of its V vectors."""
        return tuple(UNITS[name] for name in self.quantities)

    def whitener(self, first: int, last: int) -> Whitener:
        """Whitening of frames [first, last)."""
        key = (first, last)
        if key not in self._whiteners:
            noise = NoiseModel.white(np.hypot(self.sigma, self.grid), self.noise.source)
            self._whiteners[key] = Whitener(noise, np.isfinite(self.value[first:last]).all(2))
        return self._whiteners[key]

    def residual(self, predicted: np.ndarray, first: int, last: int) -> np.ndarray:
        """(N,) measured - predicted in frames [first, last), whitened. predicted: (T, V, 3)."""
        apart = self.value[first:last] - predicted[first:last]
        return self.whitener(first, last).whiten(np.nan_to_num(apart))


def sensor_observations(recording: Recording) -> tuple[SensorObservation, ...]:
    """The instruments of a sequence; noise as stated, else as the readings show it, white."""
    return tuple(_sensed(recording, sensor) for sensor in recording.sensors)


def _sensed(recording: Recording, sensor: Sensor) -> SensorObservation:
    value = np.array(sensor.value, float)
    value[~np.isfinite(value).all(2)] = np.nan
    stated = np.isfinite(sensor.sigma)
    sigma = np.where(stated, sensor.sigma, [seen_noise(value[:, v]) for v in range(value.shape[1])])
    source = "stated, taken as white" if stated.all() else "seen from frame to frame, taken as white"
    value[~compared_frames(recording, sensor)] = np.nan
    return SensorObservation(sensor.label, sensor.quantities, value, NoiseModel.white(sigma, source))


def seen_noise(value: np.ndarray) -> float:
    """Standard deviation of a coordinate that differences of a series (T, 3) show, NaN where not measured.

    Differences of order k of white noise of variance s^2 have the variance (2k over k) s^2, and of a motion
    they keep less with every order (Gasser, Sroka and Jennen-Steinmetz, Biometrika 73, 1986): the least of a
    few orders.
    """
    found = []
    for order in ORDERS:
        differences = np.diff(value, n=order, axis=0)
        seen = np.isfinite(differences).all(1)
        if seen.sum() > order:
            # The median of squares bears single shocks; of a chi-square of three degrees it is 2.366.
            squares = (differences[seen] ** 2).sum(1) / comb(2 * order, order)
            found.append(float(np.sqrt(np.median(squares) / 2.366)))
    size = float(np.sqrt(np.nanmean(value**2)))
    return max(min(found, default=0.1 * size), LEAST * size, 1e-12)


@dataclass(frozen=True, eq=False)
class ComparedSensor:
    """What a model says that an instrument reads. predicted: (T, V, 3); jacobian: (T, V, 3, P) by the free
    coordinates; refinement: (T, V, 3) change of it under refinement, extrapolated, or None."""

    sensed: SensorObservation
    predicted: np.ndarray
    jacobian: np.ndarray
    refinement: np.ndarray | None = None


def sensor_blocks(
    sensors: Sequence[SensorObservation], first: int, last: int
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) number of the instrument and frame, from `first` on, of the rows of `whitened_readings`."""
    frames = [sensor.whitener(first, last).frame for sensor in sensors]
    number = [np.full(len(frame), k) for k, frame in enumerate(frames)]
    return np.concatenate(number), np.concatenate(frames)


def whitened_readings(
    sensors: Sequence[SensorObservation], readings: Sequence[Reading], first: int, last: int
) -> tuple[np.ndarray, np.ndarray]:
    """(N,) residuals of a sequence's instruments in frames [first, last), one after the other, and the
    Jacobian of what is predicted, (N, K). Raises ValueError where there are other readings than sensors."""
    residuals = [s.residual(r.value, first, last) for s, r in zip(sensors, readings, strict=True)]
    slopes = [
        s.whitener(first, last).whiten(r.jacobian[first:last])
        for s, r in zip(sensors, readings, strict=True)
    ]
    return np.concatenate(residuals), np.concatenate(slopes)


def with_grid(
    sensors: Sequence[SensorObservation], errors: Sequence[np.ndarray]
) -> tuple[SensorObservation, ...]:
    """Sensors that count a grid's error as noise. errors: of each, (T, V, 3), of what is read of a model."""
    out = []
    for sensor, error in zip(sensors, errors, strict=True):
        told = np.isfinite(sensor.value[: len(error)]).all(2)
        square = np.where(told[..., None], error, 0.0) ** 2
        count = 3 * np.maximum(told.sum(0), 1)
        out.append(replace(sensor, grid=np.sqrt(square.sum(axis=(0, 2)) / count)))
    return tuple(out)


def sensor_errors(
    sensors: Sequence[ComparedSensor], frames: Mapping[str, np.ndarray]
) -> list[dict[str, object]]:
    """By quantity of every instrument: "fit", "predict", "all" -> error as JSON knows it, None where nothing
    was measured. frames: (T,) bool of each."""
    out = []
    for one in sensors:
        for v, (quantity, unit) in enumerate(zip(one.sensed.quantities, one.sensed.units, strict=True)):
            distance = np.linalg.norm(one.sensed.value[:, v] - one.predicted[:, v], axis=-1)
            sigma = float(one.sensed.sigma[v])
            entry = {"sensor": one.sensed.label, "quantity": quantity, "unit": unit, "sigma": sigma}
            entry["noise"] = one.sensed.noise.source
            entry["grid"] = float(np.broadcast_to(one.sensed.grid, one.sensed.sigma.shape)[v])
            out.append(entry | {label: _error(distance[mask], sigma) for label, mask in frames.items()})
    return out


def quantity_label(sensor: str, quantity: str) -> str:
    """What a quantity of a sensor is called, which may say it already."""
    return sensor if sensor.startswith(quantity) else f"{sensor}, {quantity}"


def sensor_lines(document: Mapping[str, Sequence[Mapping[str, object]]]) -> list[list[str]]:
    """Rows of a table, its head first; grid: rms of what it gets wrong. document: by sequence, as of
    `sensor_errors`."""
    rows = [["sequence", "sensor", "frames", "rms", "max", "grid", "unit", "rms / sigma", "readings"]]
    for name, entries in document.items():
        for entry in entries:
            what = quantity_label(str(entry["sensor"]), str(entry["quantity"]))
            for label in ("fit", "predict", "all"):
                if error := entry.get(label):
                    numbers = [f"{x:.4g}" for x in (error["rms"], error["max"], 3**0.5 * entry["grid"])]
                    numbers.append(str(entry["unit"]))
                    last = [f"{error['rms_over_sigma']:.3f}", str(error["count"])]
                    rows.append([name, what, label, *numbers, *last])
    return rows


def _error(distance: np.ndarray, sigma: float) -> dict[str, float] | None:
    """Of distances (N,), NaN where not measured."""
    distance = distance[np.isfinite(distance)]
    if not len(distance):
        return None
    rms = float(np.sqrt(np.mean(distance**2)))
    return {
        "rms": rms,
        "max": float(distance.max()),
        "rms_over_sigma": rms / (sigma * np.sqrt(3.0)),
        "count": len(distance),
    }
