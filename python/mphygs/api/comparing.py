"""Prediction beside measurement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mphygs.api.calls import CaptureLike, Home, Progress, RunLike, call, comma, folder_of, home_of, json_of
from mphygs.api.interface_errors import InputError
from mphygs.api.results import Error, Row, Table, error_rows, errors_of, sensor_rows
from mphygs.capture.format import Capture
from mphygs.commands.compare import CompareOptions, compared_run, comparison_figure
from mphygs.compare.assess import Compared, in_words
from mphygs.compare.sensor_pictures import sensor_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Comparison(Table):
    """How far a model is from the measurement. run: of the model; document: the command's JSON; capture: what
    was measured; compared: by sequence, measured and predicted positions, (T, M, 3) [m]."""

    run: Path
    document: Mapping[str, Any]
    capture: Capture
    compared: Mapping[str, Compared]
    _home: Home | None = field(default=None, repr=False)

    @property
    def adequate(self) -> bool:
        """Whether the misfit is no more than noise and the grid's share."""
        return bool(self.document["adequate"])

    @property
    def p_value(self) -> float:
        """Chance of such a misfit by noise alone, the grid's share allowed for."""
        return float(self.document["p_value"])

    @property
    def sequences(self) -> dict[str, dict[str, Error | None]]:
        """Errors by sequence, on frames fitted, on others, and on all."""
        return errors_of(self.document["sequences"])

    @property
    def sensors(self) -> list[Row]:
        """One row an instrument's quantity and range of frames: rms and max in its unit, rms over sigma."""
        return sensor_rows(self.document.get("sensors", {}))

    def title(self) -> str:
        """The verdict in words."""
        return f"the misfit is {in_words(self.adequate, self.p_value)} (p = {self.p_value:.2g})"

    def rows(self) -> list[Row]:
        """One row a sequence and range of frames: rms and max [m], rms over sigma, count."""
        return error_rows(self.sequences)

    def plot(self, sequence: str | None = None) -> Figure:
        """Measured and predicted curves of one sequence, by default the first. Raises InputError where that
        was not compared."""
        name = next(iter(self.compared)) if sequence is None else sequence
        if name not in self.compared:
            known = ", ".join(self.compared)
            raise InputError(f"sequence '{name}' was not compared; expected one of {known}")
        return comparison_figure(self.capture, name, self.compared[name])

    def plot_sensors(self, sequence: str | None = None) -> Figure:
        """What the instruments of one sequence measured and what is predicted, by default of the first that
        has any. Raises InputError where there are none."""
        having = [name for name, item in self.compared.items() if item.sensors]
        name = sequence if sequence is not None else next(iter(having), None)
        if name not in having:
            known = f"one of {', '.join(having)}" if having else "a capture with sensors"
            what = "no sequence" if sequence is None else f"sequence '{sequence}'"
            raise InputError(f"{what} has sensors that were compared; expected {known}")
        return sensor_figure(self.compared[name], name=name, fps=self.capture.sequence(name).fps)


def compare(
    run: RunLike,
    *,
    capture: CaptureLike | None = None,
    sequences: Sequence[str] | str = (),
    feedback: float | None = None,
    out: str | Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Hold a fitted model against the measurement, as `mphygs compare` does, to the same numbers.

    run: a result with a run, or its folder; capture: another one of the same object; feedback: gain, above 0
    to 1; out: folder of the pictures. Raises InputError or FailedError.
    """
    other = capture.folder if isinstance(capture, Capture) else None if capture is None else Path(capture)
    options = CompareOptions(
        run=folder_of(run),
        capture=other,
        sequences=comma(sequences),
        feedback=feedback,
        out=None if out is None else Path(out),
        workers=workers,
    )
    found = call(compared_run, options, progress)
    return Comparison(
        folder_of(run), json_of(found.document), found.experiment.capture, found.compared, home_of(run)
    )
