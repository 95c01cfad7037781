"""What all results have: a table that is shown in notebooks and becomes a data frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from mphygs.api.interface_errors import MissingPackageError
from mphygs.report.html import html_table

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

Row = dict[str, Any]
# Ranges of frames that have an error of their own.
RANGES = ("fit", "predict", "all")


class Table:
    """A result as rows of a table."""

    def rows(self) -> list[Row]:
        """The rows, each column name -> value, None where there is none."""
        raise NotImplementedError

    def title(self) -> str:
        """A line above the table."""
        return ""

    def to_dataframe(self) -> pandas.DataFrame:
        """The rows as a pandas data frame. Raises MissingPackageError without pandas."""
        try:
            import pandas
        except ImportError as error:
            raise MissingPackageError(
                "to_dataframe: pandas is not installed; expected it (pip install pandas)"
            ) from error
        return pandas.DataFrame(self.rows())

    def _repr_html_(self) -> str:
        rows = self.rows()
        head = list(dict.fromkeys(key for row in rows for key in row))
        cells = [["" if row.get(key) is None else row[key] for key in head] for row in rows]
        title = self.title()
        return (html_table(["what"], [[title]]) if title else "") + html_table(head, cells)


@dataclass(frozen=True)
class Error:
    """Distance of predicted from measured points. rms, max [m]; rms_over_sigma: 1 for pure noise; count: of
    points measured. Of pictures also psnr [dB], iou and chamfer_px [pixel]."""

    rms: float | None
    max: float | None
    rms_over_sigma: float | None
    count: int | None
    psnr: float | None = None
    iou: float | None = None
    chamfer_px: float | None = None


def errors_of(sequences: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Error | None]]:
    """Errors by sequence and range of frames, from a document."""
    known = Error.__dataclass_fields__
    return {
        name: {
            label: None
            if ranges.get(label) is None
            else Error(**{key: ranges[label].get(key) for key in known})
            for label in RANGES
            if label in ranges
        }
        for name, ranges in sequences.items()
    }


def error_rows(sequences: Mapping[str, Mapping[str, Error | None]]) -> list[Row]:
    """A row for every sequence and range of frames with something measured."""
    return [
        {
            "sequence": name,
            "frames": label,
            "rms": error.rms,
            "max": error.max,
            "rms_over_sigma": error.rms_over_sigma,
            "count": error.count,
        }
        for name, ranges in sequences.items()
        for label, error in ranges.items()
        if error is not None
    ]


def sensor_rows(sensors: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Row]:
    """A row for every quantity of an instrument and range of frames with something measured, from a
    document."""
    return [
        {
            "sequence": name,
            "sensor": entry["sensor"],
            "quantity": entry["quantity"],
            "unit": entry["unit"],
            "sigma": entry["sigma"],
            "frames": label,
            **error,
        }
        for name, entries in sensors.items()
        for entry in entries
        for label in RANGES
        if (error := entry.get(label)) is not None
    ]


@dataclass(frozen=True)
class Estimate:
    """A fitted number. std: standard error, in the value's unit; determined: whether the data tell it, note:
    why not, or what else is to be said; interval: of two standard deviations from the likelihood, where it
    was asked for; bound: "lower" or "upper" of what shows on one side alone, or both."""

    value: float
    std: float | None
    unit: str
    determined: bool
    note: str = ""
    interval: tuple[float, float] | None = None
    bound: Mapping[str, float] | None = None

    def __str__(self) -> str:
        spread = "" if self.std is None else f" +- {self.std:.2g}"
        unit = "" if self.unit == "-" else f" {self.unit}"
        return f"{self.value:.5g}{spread}{unit}" + ("" if self.determined else ", not determined")


def estimates_of(parameters: Mapping[str, Mapping[str, Any]]) -> dict[str, Estimate]:
    """Fitted numbers by key, from a document."""
    return {
        key: Estimate(
            value=entry["value"],
            std=entry.get("std"),
            unit=entry["unit"],
            determined=bool(entry.get("determined", True)),
            note=entry.get("note", ""),
            interval=tuple(entry["interval"]) if entry.get("interval") else None,
            bound=dict(entry["bound"]) if entry.get("bound") else None,
        )
        for key, entry in parameters.items()
    }


def errors_figure(names: Sequence[str], series: Mapping[str, Sequence[float | None]]) -> Figure:
    """A matplotlib figure of errors over the noise. names: along the axis; series: label -> a value each."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for label, values in series.items():
        known = [(k, v) for k, v in enumerate(values) if v is not None]
        axes.plot([k for k, _ in known], [v for _, v in known], "o-", label=label)
    axes.axhline(1.0, color="#999999", ls="--", lw=0.8, label="noise")
    axes.set(ylabel="rms / sigma", yscale="log")
    axes.set_xticks(range(len(names)), names, rotation=20 if len(names) > 3 else 0)
    axes.legend(fontsize=8)
    return figure
