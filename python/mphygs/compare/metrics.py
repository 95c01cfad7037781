"""How far a prediction is from its measurement, in metres and in standard deviations of the noise."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import numpy as np

from mphygs.compare.assess import Compared
from mphygs.compare.sensor_residuals import sensor_errors

RANGES = ("fit", "predict", "all")


@dataclass(frozen=True)
class PointError:
    """Distance of predicted points from measured ones.

    rms, max: of the Euclidean distance over frames and points [m]; rms_over_sigma: rms / (sigma sqrt(3)),
    1 for pure noise; count: of points measured in those frames.
    """

    rms: float
    max: float
    rms_over_sigma: float
    count: int


def point_error(
    measured: np.ndarray, predicted: np.ndarray, sigma: float, frames: np.ndarray | slice = slice(None)
) -> PointError | None:
    """Error over some frames; None where nothing was measured in them.

    measured: (T, M, 3) [m], NaN where missing; predicted: (T, M, 3) [m]; sigma: of one coordinate [m];
    frames: (T,) bool or a slice. Raises ValueError where the shapes differ.
    """
    if measured.shape != predicted.shape:
        raise ValueError(f"prediction of shape {predicted.shape}: expected {measured.shape}, as measured")
    distance = np.linalg.norm(measured[frames] - predicted[frames], axis=-1)
    distance = distance[np.isfinite(distance)]
    if not len(distance):
        return None
    rms = float(np.sqrt(np.mean(distance**2)))
    return PointError(rms, float(distance.max()), rms / (sigma * np.sqrt(3.0)), len(distance))


def frame_masks(compared: Compared) -> dict[str, np.ndarray]:
    """(T,) bool of the frames fitted, of those kept for prediction and not fitted, and of both."""
    frames = np.arange(len(compared.predicted))
    fit, predict = ((frames >= first) & (frames < last) for first, last in (compared.fit, compared.predict))
    return {"fit": fit, "predict": predict & ~fit, "all": fit | predict}


def sensors_document(compared: Mapping[str, Compared]) -> dict[str, list[dict[str, object]]]:
    """Errors of the instruments of those sequences that have any, see `sensor_errors`."""
    return {
        name: sensor_errors(item.sensors, frame_masks(item))
        for name, item in compared.items()
        if item.sensors
    }


def sequence_errors(
    compared: Mapping[str, Compared], sigmas: Mapping[str, float]
) -> dict[str, dict[str, dict[str, float] | None]]:
    """Sequence -> "fit", "predict", "all" -> error as JSON knows it, None where there is no such frame.

    sigmas: standard deviation of the markers' noise, by sequence [m]; of some frames alone it is theirs.
    """
    out = {}
    for name, item in compared.items():
        errors = {}
        for label, frames in frame_masks(item).items():
            course = item.observation.frames_of_noise[frames]
            sigma = sigmas[name] * float(np.sqrt(np.mean(course**2))) if len(course) else sigmas[name]
            errors[label] = point_error(item.observation.position, item.predicted, sigma, frames)
        out[name] = {label: None if error is None else asdict(error) for label, error in errors.items()}
    return out
