"""Predictions beside measurements, and all their rows, whitened."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mphygs.compare.noise import Observation
from mphygs.compare.sensor_residuals import ComparedSensor


@dataclass(frozen=True, eq=False)
class Compared:
    """Prediction and measurement of one sequence.

    predicted: (T, M, 3) [m]; jacobian: (T, M, 3, P) by the free coordinates; part: (M,) of every marker;
    refinement: (T, M, 3) change of the prediction under refinement, extrapolated, or None;
    fit, predict: frame ranges; tangents_of: spacing of the grid that the Jacobian is of [m], None for the
    prediction's; sensors: other instruments; stays: whether a finer grid has been seen to leave the misfit as
    it is, so that the refinement excuses nothing (see `mphygs.compare.assess.stays`).
    """

    observation: Observation
    predicted: np.ndarray
    jacobian: np.ndarray
    part: np.ndarray
    fit: tuple[int, int]
    predict: tuple[int, int]
    refinement: np.ndarray | None = None
    tangents_of: float | None = None
    sensors: tuple[ComparedSensor, ...] = ()
    stays: bool = False

    @property
    def frames(self) -> tuple[int, int]:
        """First and last frame of either range."""
        used = [r for r in (self.fit, self.predict) if r[1] > r[0]]
        return min(a for a, _ in used), max(b for _, b in used)


@dataclass(frozen=True, eq=False)
class Whitened:
    """All compared rows, the markers of one sequence after the other and then its instruments.

    fitted: rows of frames that were fitted; part: of the marker, of an instrument -1 less its number; sigma:
    (N,) of the noise of each row's sequence and frame [m], NaN where it is of another unit.
    """

    residual: np.ndarray
    jacobian: np.ndarray
    refinement: np.ndarray
    part: np.ndarray
    frame: np.ndarray
    sequence: np.ndarray
    fitted: np.ndarray
    sigma: np.ndarray
    names: tuple[str, ...]


def whiten_all(compared: Mapping[str, Compared]) -> Whitened:
    """Whitened residual (measured - predicted), Jacobian of the prediction and refinement of all sequences.

    Each sequence is whitened over the frames of its two ranges together.
    """
    parts: list[tuple] = []
    for number, item in enumerate(compared.values()):
        first, last = item.frames
        window = slice(first, last)
        whitener = item.observation.whitener(first, last)
        rows = whitener.whiten(np.nan_to_num(item.observation.position[window] - item.predicted[window]))
        jacobian = whitener.whiten(item.jacobian[window])
        refinement = np.zeros_like(item.predicted) if item.refinement is None else item.refinement
        frame = whitener.frame + first
        fitted = (frame >= item.fit[0]) & (frame < item.fit[1])
        used = fitted | ((frame >= item.predict[0]) & (frame < item.predict[1]))
        parts.append(
            (
                rows[used],
                jacobian[used],
                whitener.whiten(refinement[window])[used],
                item.part[whitener.marker][used],
                frame[used],
                np.full(int(used.sum()), number),
                fitted[used],
                item.observation.sigma * item.observation.frames_of_noise[frame[used]],
            )
        )
        parts += [_sensor_rows(item, k, number) for k in range(len(item.sensors))]
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    return Whitened(*joined, tuple(compared))


def _sensor_rows(item: Compared, k: int, number: int) -> tuple:
    """The columns of `Whitened` for one instrument of a sequence."""
    own, (first, last) = item.sensors[k], item.frames
    whitener = own.sensed.whitener(first, last)
    frame = whitener.frame + first
    fitted = (frame >= item.fit[0]) & (frame < item.fit[1])
    used = fitted | ((frame >= item.predict[0]) & (frame < item.predict[1]))
    moved = np.zeros_like(own.predicted) if own.refinement is None else own.refinement
    count = int(used.sum())
    return (
        own.sensed.residual(own.predicted, first, last)[used],
        whitener.whiten(own.jacobian[first:last])[used],
        whitener.whiten(moved[first:last])[used],
        np.full(count, -1 - k),
        frame[used],
        np.full(count, number),
        fitted[used],
        np.full(count, np.nan),
    )
