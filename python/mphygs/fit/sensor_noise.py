"""What a grid gets wrong of what instruments read, which counts as noise of theirs."""

from __future__ import annotations

import numpy as np

from mphygs.compare.sensor_residuals import ComparedSensor, SensorObservation, with_grid
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Prediction, Predictor


def with_grid_error(
    sensors: tuple[SensorObservation, ...],
    fine: Predictor,
    coarse: Predictor,
    ratio: float,
    belief: Belief,
    last: int,
) -> tuple[SensorObservation, ...]:
    """The sensors of a sequence with the finer grid's error at a belief, as they are where it cannot be
    simulated.

    ratio: of the spacings, above 1; by Richardson the error is their difference over ratio^2 - 1; last:
    of the frames that are looked at, from 0 on.
    """
    read = []
    for predictor in (fine, coarse):
        predictor.forget()  # a fit that goes on from here has the same noise to the last bit
        try:
            read.append(predictor.predict(belief, last=last).readings)
        except SimulationError:
            return sensors
    whole = ratio**2 - 1.0
    return with_grid(sensors, [(b.value - a.value) / whole for a, b in zip(*read, strict=True)])


def compared_sensors(
    sensors: tuple[SensorObservation, ...], prediction: Prediction, frames: int
) -> tuple[ComparedSensor, ...]:
    """Sensors beside what is predicted of them, zero in those of all frames that were not computed."""
    return tuple(
        ComparedSensor(sensor, full(reading.value, frames), full(reading.jacobian, frames))
        for sensor, reading in zip(sensors, prediction.readings, strict=True)
    )


def full(array: np.ndarray, frames: int) -> np.ndarray:
    """Zeros after the frames that were computed, so that indices are the recording's."""
    out = np.zeros((frames, *array.shape[1:]))
    out[: len(array)] = array
    return out
