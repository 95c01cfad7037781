"""What instruments measured and what is predicted that they read, as a chart of the page."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

import numpy as np

from mphygs.compare.assess import Compared
from mphygs.compare.sensor_residuals import quantity_label
from mphygs.report.charts import figure

AXES = "xyz"
# Colours and marks of the axes, the same for what was measured and for what is predicted.
COLOURS = ("$fitted", "$unseen", "$grid")
SYMBOLS = ("circle-open", "square-open", "diamond-open")
HEIGHT = 230  # pixels of a row


def sensors_chart(compared: Mapping[str, Compared], fps: Mapping[str, float]) -> dict[str, object] | None:
    """A row for every quantity of every instrument: measured as marks, predicted as lines, fitted frames
    shaded. fps: frames per second by sequence; None where no sequence has instruments."""
    rows = [
        (name, item, one, v)
        for name, item in compared.items()
        for one in item.sensors
        for v in range(len(one.sensed.quantities))
    ]
    if not rows:
        return None
    traces: list[dict[str, object]] = []
    layout: dict[str, object] = {}
    shapes, notes = [], []
    gap = 0.35 / len(rows) if len(rows) > 1 else 0.0
    size = (1.0 - gap * (len(rows) - 1)) / len(rows)
    for k, (name, item, one, v) in enumerate(rows):
        number = "" if k == 0 else str(k + 1)
        top = 1.0 - k * (size + gap)
        quantity, unit = one.sensed.quantities[v], one.sensed.units[v]
        layout[f"yaxis{number}"] = {
            "domain": [max(top - size, 0.0), top], "anchor": f"x{number}", "title": {"text": escape(unit)},
        }  # fmt: skip
        title = {"text": "time [s]" if k == len(rows) - 1 else ""}
        layout[f"xaxis{number}"] = {"anchor": f"y{number}", "title": title}
        window = np.arange(*item.frames)
        times = (window / fps[name]).tolist()
        told = np.isfinite(one.sensed.value[window, v]).all(1)
        if item.fit[1] > item.fit[0]:
            shapes.append(
                {"type": "rect", "xref": f"x{number}", "yref": f"y{number} domain", "y0": 0, "y1": 1,
                 "x0": item.fit[0] / fps[name], "x1": (item.fit[1] - 1) / fps[name], "layer": "below",
                 "line": {"width": 0}, "fillcolor": "$quiet", "opacity": 0.12}
            )  # fmt: skip
        text = quantity_label(one.sensed.label, quantity)
        notes.append(
            {"xref": "paper", "yref": "paper", "x": 0, "y": top, "xanchor": "left", "yanchor": "bottom",
             "showarrow": False, "text": escape(f"{name}: {text}")}
        )  # fmt: skip
        for c, axis in enumerate(AXES):
            place = {"xaxis": f"x{number}", "yaxis": f"y{number}", "x": times, "showlegend": k == 0}
            hover = f"{axis}: %{{y:.4g}} {escape(unit)} at %{{x:.3f}} s<extra></extra>"
            for curve, kind, words in (
                (one.sensed.value, "markers", "measured"),
                (one.predicted, "lines", "predicted"),
            ):
                values = np.where(told, curve[window, v, c], np.nan)
                traces.append(
                    place
                    | {
                        "type": "scatter",
                        "mode": kind,
                        "name": f"{axis} {words}",
                        "legendgroup": f"{axis} {words}",
                        "y": [None if not np.isfinite(y) else float(f"{y:.6g}") for y in values],
                        "marker": {"size": 5, "color": COLOURS[c], "symbol": SYMBOLS[c]},
                        "line": {"width": 2, "color": COLOURS[c]},
                        "hovertemplate": hover,
                    }
                )
    margin = {"l": 80, "r": 24, "t": 60, "b": 56}
    return figure(
        "chart-sensors", 120 + HEIGHT * len(rows), traces, shapes=shapes, annotations=notes, margin=margin,
        **layout,
    )  # fmt: skip
