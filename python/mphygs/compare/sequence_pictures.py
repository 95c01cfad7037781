"""One picture per sequence: what was measured, what was predicted, where and when they differ."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mphygs.capture.written import replace_file
from mphygs.compare.assess import Compared
from mphygs.compare.metrics import frame_masks

MEASURED, PREDICTED, FITTED_SHADE = "#333333", "#d1495b", "#e8f0e4"
# Width of the noise band, in standard deviations to either side.
BAND = 2.0


def moving_most(measured: np.ndarray, count: int) -> list[tuple[int, int]]:
    """(marker, coordinate) of the largest motions, one coordinate a marker, the largest first.

    measured: (T, M, 3) [m], NaN where missing.
    """
    spread = np.zeros(measured.shape[1:])
    seen = np.isfinite(measured).any(0)
    low, high = (np.where(np.isfinite(measured), measured, fill) for fill in (np.inf, -np.inf))
    spread[seen] = (high.max(0) - low.min(0))[seen]
    order = np.argsort(-spread.max(1), kind="stable")[:count]
    return [(int(m), int(spread[m].argmax())) for m in order]


def farthest_off(compared: Compared) -> tuple[int, int]:
    """(marker, coordinate) of the largest root mean square misfit over the compared frames."""
    window = slice(*compared.frames)
    squares = (compared.observation.position[window] - compared.predicted[window]) ** 2
    count = np.isfinite(squares).sum(0)
    mean = np.nan_to_num(squares).sum(0) / np.maximum(count, 1)
    marker, coordinate = np.unravel_index(int(mean.argmax()), mean.shape)
    return int(marker), int(coordinate)


def part_residual(compared: Compared, part: int) -> np.ndarray:
    """(T,) root mean square distance over the markers of one part [m], NaN where none was measured."""
    difference = compared.observation.position - compared.predicted
    square = (difference**2).sum(-1)[:, compared.part == part]
    count = np.isfinite(square).sum(1)
    return np.sqrt(np.where(count > 0, np.nansum(square, 1), np.nan) / np.maximum(count, 1))


def spectrum(curve: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] and amplitudes [m] of a motion, (T,) [m]; gaps are bridged by straight lines."""
    frames = np.arange(len(curve))
    seen = np.isfinite(curve)
    filled = np.interp(frames, frames[seen], curve[seen])
    window = np.hanning(len(curve))
    amplitude = 2.0 * np.abs(np.fft.rfft((filled - filled.mean()) * window)) / window.sum()
    return np.fft.rfftfreq(len(curve), 1.0 / fps), amplitude


def _shade(axes: Axes, compared: Compared, fps: float) -> None:
    first, last = compared.fit
    if last > first:
        axes.axvspan(first / fps, (last - 1) / fps, color=FITTED_SHADE, zorder=0, label="fitted frames")


def _curve(axes: Axes, compared: Compared, fps: float, marker: int, coordinate: int, label: str) -> None:
    window = slice(*compared.frames)
    times = np.arange(len(compared.predicted))[window] / fps
    predicted = 1e3 * compared.predicted[window, marker, coordinate]
    measured = 1e3 * compared.observation.position[window, marker, coordinate]
    band = 1e3 * BAND * compared.observation.sigma
    _shade(axes, compared, fps)
    axes.fill_between(times, predicted - band, predicted + band, color=PREDICTED, alpha=0.2, lw=0)
    axes.plot(times, measured, ".", ms=3, color=MEASURED, label="measured")
    axes.plot(times, predicted, color=PREDICTED, lw=1.2, label=f"predicted, {BAND:g} sigma of noise")
    axes.set(title=f"{label}, {'xyz'[coordinate]}", xlabel="time [s]", ylabel="mm")


def _residual(axes: Axes, compared: Compared, fps: float, parts: Sequence[str]) -> None:
    window = slice(*compared.frames)
    times = np.arange(len(compared.predicted))[window] / fps
    _shade(axes, compared, fps)
    for part, name in enumerate(parts):
        if (compared.part == part).any():
            axes.plot(times, 1e3 * part_residual(compared, part)[window], lw=1.0, label=name)
    floor = 1e3 * compared.observation.sigma * np.sqrt(3.0)
    axes.axhline(floor, color=MEASURED, ls="--", lw=0.8, label="noise")
    axes.set(title="distance by part", xlabel="time [s]", ylabel="rms mm", ylim=(0, None))
    axes.legend(fontsize=7, loc="best")


def _field(figure: Figure, axes: Axes, compared: Compared, at: np.ndarray) -> None:
    """Root mean square distance of every marker, on the object seen along its thinnest direction."""
    used = np.logical_or.reduce(list(frame_masks(compared).values()))
    square = ((compared.observation.position - compared.predicted)[used] ** 2).sum(-1)
    count = np.isfinite(square).sum(0)
    rms = np.sqrt(np.nansum(square, 0) / np.maximum(count, 1))
    first, second = np.sort(np.argsort(-np.ptp(at, axis=0), kind="stable")[:2])
    shown = axes.scatter(
        1e3 * at[:, first], 1e3 * at[:, second], c=1e3 * rms, s=28, cmap="viridis", vmin=0.0,
        edgecolors="#888888", linewidths=0.4,
    )  # fmt: skip
    figure.colorbar(shown, ax=axes, label="rms mm", shrink=0.85)
    axes.set(
        title="distance by marker, at rest", xlabel=f"{'xyz'[first]} [mm]", ylabel=f"{'xyz'[second]} [mm]"
    )
    axes.set_aspect("equal", "datalim")


def _spectrum(axes: Axes, compared: Compared, fps: float, marker: int, coordinate: int) -> None:
    window = slice(*compared.frames)
    for values, colour, label in (
        (compared.observation.position, MEASURED, "measured"),
        (compared.predicted, PREDICTED, "predicted"),
    ):
        curve = values[window, marker, coordinate]
        if np.isfinite(curve).sum() > 3:
            frequency, amplitude = spectrum(curve, fps)
            axes.semilogy(frequency[1:], 1e3 * amplitude[1:], color=colour, lw=1.0, label=label)
    axes.set(title="spectrum of the second curve", xlabel="Hz", ylabel="amplitude mm")
    if axes.lines:  # hardly anything was measured of this marker otherwise
        axes.legend(fontsize=7, loc="best")


def sequence_figure(
    compared: Compared,
    *,
    name: str,
    fps: float,
    at: np.ndarray,
    parts: Sequence[str],
    labels: Sequence[str] = (),
) -> Figure:
    """The picture of one sequence.

    fps: frames per second; at: (M, 3) markers at rest [m]; parts: names; labels: of markers, numbers if none.
    """
    figure = Figure(figsize=(13.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    window = slice(*compared.frames)
    off = farthest_off(compared)
    chosen = {"largest motion": moving_most(compared.observation.position[window], 1)[0], "farthest off": off}
    for place, (what, (marker, coordinate)) in zip((axes[0, 0], axes[0, 1]), chosen.items(), strict=True):
        label = labels[marker].replace("$", r"\$") if len(labels) else f"marker {marker}"
        _curve(place, compared, fps, marker, coordinate, f"{what}: {label}")
    _residual(axes[1, 0], compared, fps, parts)
    _field(figure, axes[1, 1], compared, at)
    _spectrum(axes[0, 2], compared, fps, *off)
    difference = (compared.observation.position - compared.predicted)[window]
    values = difference[np.isfinite(difference)] / compared.observation.sigma
    reach = max(4.0, float(np.abs(values).max(initial=0.0)))
    axes[1, 2].hist(values, bins=60, range=(-reach, reach), density=True, color=PREDICTED, alpha=0.6)
    x = np.linspace(-reach, reach, 200)
    axes[1, 2].plot(x, np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi), color=MEASURED, lw=1.0, label="noise alone")
    axes[1, 2].set(title="residual of one coordinate", xlabel="sigma", ylabel="density")
    axes[1, 2].legend(fontsize=7)
    figure.suptitle(f"{name}: measured and predicted")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="upper left", ncols=3, fontsize=8)
    return figure


def save_figure(figure: Figure, path: Path) -> None:
    """Write a picture as .png; the same figure gives the same file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    replace_file(path, buffer.getvalue())
