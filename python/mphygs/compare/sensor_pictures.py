"""One picture of a sequence's instruments: what they measured and what a model says that they read."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mphygs.compare.assess import Compared
from mphygs.compare.sensor_residuals import quantity_label
from mphygs.compare.sequence_pictures import BAND, FITTED_SHADE, MEASURED, PREDICTED


def sensor_figure(compared: Compared, *, name: str, fps: float) -> Figure:
    """A row for every quantity of every instrument, a column for each axis. fps: frames per second."""
    rows = [(one, v) for one in compared.sensors for v in range(len(one.sensed.quantities))]
    figure = Figure(figsize=(13.0, 0.6 + 2.4 * len(rows)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(rows), 3, squeeze=False, sharex=True)
    window = slice(*compared.frames)
    times = np.arange(len(compared.predicted))[window] / fps
    for (one, v), line in zip(rows, axes, strict=True):
        band = BAND * float(one.sensed.sigma[v])
        told = np.isfinite(one.sensed.value[window, v]).all(1)
        for c, place in enumerate(line):
            predicted = np.where(told, one.predicted[window, v, c], np.nan)
            if compared.fit[1] > compared.fit[0]:
                ends = compared.fit[0] / fps, (compared.fit[1] - 1) / fps
                place.axvspan(*ends, color=FITTED_SHADE, zorder=0, label="fitted frames")
            place.fill_between(times, predicted - band, predicted + band, color=PREDICTED, alpha=0.2, lw=0)
            place.plot(times, one.sensed.value[window, v, c], ".", ms=3, color=MEASURED, label="measured")
            label = f"predicted, {BAND:g} sigma of noise"
            place.plot(times, predicted, color=PREDICTED, lw=1.2, label=label)
            place.set(ylabel=one.sensed.units[v])
            what = quantity_label(one.sensed.label, one.sensed.quantities[v])
            place.set_title(f"{what}: {'xyz'[c]}", fontsize=9)
    for place in axes[-1]:
        place.set(xlabel="time [s]")
    figure.suptitle(f"{name}: what instruments measured, and predicted")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="upper left", ncols=3, fontsize=8)
    return figure
