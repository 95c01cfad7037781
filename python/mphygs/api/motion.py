"""A model simulated: where its points go."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from mphygs.api.interface_errors import InputError, as_interface_errors
from mphygs.api.model import Model
from mphygs.api.results import Row, Table
from mphygs.capture.format import Sequence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Points that are drawn, those that move most.
SHOWN = 4


@dataclass(frozen=True, eq=False)
class Motion(Table):
    """name: of the sequence; times: (T,) [s]; position: (T, M, 3) [m]; velocity: (T, M, 3) [m/s];
    substeps: that were computed, substep: the longest of them [s]; readings: by instrument of the sequence,
    (T, V, 3): force [N] and torque [N m] of a hold, or an acceleration [m/s^2]."""

    name: str
    times: NDArray[np.float64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    substeps: int
    substep: float
    readings: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    def title(self) -> str:
        """How much was simulated."""
        frames, points = self.position.shape[:2]
        return f"{self.name}: {frames} frames, {points} points, {self.substeps} substeps"

    def rows(self) -> list[Row]:
        """One row a frame and point: time [s], x, y, z [m]."""
        return [
            {"frame": k, "time": float(time), "point": m, "x": x, "y": y, "z": z}
            for k, time in enumerate(self.times)
            for m, (x, y, z) in enumerate(self.position[k].tolist())
        ]

    def _repr_html_(self) -> str:
        from html import escape

        return f"<p>{escape(self.title())}</p>"

    def plot(self) -> Figure:
        """Displacements over time of the points that move most."""
        from matplotlib.figure import Figure

        from mphygs.compare.sequence_pictures import moving_most

        figure = Figure(figsize=(7.0, 4.0), layout="constrained")
        axes = figure.subplots()
        for point, axis in moving_most(self.position, SHOWN):
            curve = 1e3 * (self.position[:, point, axis] - self.position[0, point, axis])
            axes.plot(self.times, curve, label=f"point {point}, {'xyz'[axis]}")
        axes.set(xlabel="time [s]", ylabel="mm", title=self.name)
        axes.legend(fontsize=8)
        return figure


def simulate(
    model: Model,
    sequence: str | Sequence | None = None,
    *,
    points: NDArray[np.floating] | None = None,
    frames: int | None = None,
) -> Motion:
    """Where points of an object go.

    sequence: name of a motion of the model's capture, by default the first, or one made of arrays (holds with
    a pose a frame, loads); points: (M, 3) [m] at rest, by default the sequence's markers; frames: that are
    simulated from the first on, by default all. Raises InputError, and FailedError for an unstable run.
    """
    recording = model.recording(sequence, points)
    if frames is not None and not 1 <= frames <= recording.frames:
        raise InputError(f"frames: got {frames}; expected 1 to {recording.frames} for {recording.name}")
    with as_interface_errors():
        found = model.predictor(recording).predict(model.belief, last=frames)
    return Motion(
        recording.name,
        np.asarray(found.frames / recording.fps, dtype=np.float64),
        found.position,
        found.velocity,
        found.substeps,
        float(found.dt),
        {s.label: r.value for s, r in zip(recording.sensors, found.readings, strict=True)},
    )
