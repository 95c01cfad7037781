"""The charts of a page, as figures that plotly.js draws. Colours are names that the page's theme looks up."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape

import numpy as np

# Marks of sequences, so that they are told apart without colours.
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x", "star", "hexagon")
RANGES = {"fit": ("fitted", "$fitted", "solid"), "predict": ("unseen", "$unseen", "dash")}
# Candidates that a chart of a ranking shows, parameters that one of correlations names.
RANKED, CORRELATED = 14, 24


def figure(identifier: str, height: int, data: Sequence[Mapping], **layout: object) -> dict[str, object]:
    """A figure of a height [px]; layout: of plotly."""
    margin = {"l": 70, "r": 24, "t": 24, "b": 56}
    return {"id": identifier, "data": list(data), "layout": {"height": height, "margin": margin} | layout}


def title_of(step: Mapping[str, object], first: bool) -> str:
    """A model of the loop by what is new in it."""
    if step["added"]:
        return "+ " + ", ".join(step["added"])
    return ", ".join(step["effects"]) or "elasticity alone" if first else "fitted again"


def fall_chart(
    titles: Sequence[str], steps: Sequence[Mapping[str, Mapping]], budget: Mapping[str, float]
) -> dict[str, object]:
    """Errors over the noise by model. steps: errors by sequence and range, a model each; budget: root mean
    squares of noise and discretisation [m] of the last one, whose sum is the floor of this grid."""
    traces, values = [], [1.0]
    names = list(dict.fromkeys(name for step in steps for name in step))
    for number, name in enumerate(names):
        for label, (word, colour, dash) in RANGES.items():
            errors = [(step.get(name) or {}).get(label) for step in steps]
            known = [(k, e) for k, e in enumerate(errors) if e and e.get("rms_over_sigma")]
            if not known:
                continue
            values += [e["rms_over_sigma"] for _, e in known]
            traces.append(
                {
                    "type": "scatter",
                    "mode": "lines+markers",
                    "name": f"{escape(name)}, {word}",
                    "x": [k for k, _ in known],
                    "y": [e["rms_over_sigma"] for _, e in known],
                    "customdata": [[1e3 * e["rms"], e["count"], escape(titles[k])] for k, e in known],
                    "hovertemplate": "%{customdata[2]}<br>%{y:.2f} times the noise, "
                    "%{customdata[0]:.3f} mm rms<br>%{customdata[1]} points",
                    "marker": {"symbol": SYMBOLS[number % len(SYMBOLS)], "size": 10, "color": colour},
                    "line": {"dash": dash, "width": 2.5, "color": colour},
                }
            )
    noise = max(budget["noise"], 1e-12)
    floors = [(1.0, "noise", "$quiet")]
    grid = float(np.hypot(1.0, budget["discretisation"] / noise))
    if grid > 1.02:
        floors.append((grid, "noise and grid", "$grid"))
    wide = {"xref": "paper", "x0": 0, "x1": 1, "type": "line", "layer": "below"}
    shapes = [wide | {"y0": y, "y1": y, "line": {"color": c, "dash": "dot"}} for y, _, c in floors]
    notes = [
        {"xref": "paper", "x": 1, "y": np.log10(y), "text": f"{text}: {y:.2f}", "showarrow": False,
         "xanchor": "right", "yanchor": "bottom" if k else "top", "font": {"color": c, "size": 12}}
        for k, (y, text, c) in enumerate(floors)
    ]  # fmt: skip
    low, high = np.log10(min(values) * 0.78), np.log10(max(values) * 1.25)
    across = {
        "tickvals": list(range(len(titles))),
        "ticktext": [escape(t) for t in titles],
        "range": [-0.3, len(titles) - 0.7],
    }
    up = {
        "type": "log",
        "title": {"text": "error over noise"},
        "range": [low, high],
        "tickvals": _ticks(low, high),
    }
    return figure("chart-fall", 380, traces, xaxis=across, yaxis=up, shapes=shapes, annotations=notes)


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers between two powers of ten."""
    decades = range(int(np.floor(low)), int(np.ceil(high)) + 1)
    fine = (1, 2, 5) if high - low > 0.5 else (0.8, 1, 1.2, 1.5, 2, 2.5, 3, 4, 5)
    steps = (1,) if high - low > 2.5 else fine
    found = [m * 10.0**d for d in decades for m in steps]
    return [v for v in found if low <= np.log10(v) <= high]


def ranking_rows(diagnosis: Mapping[str, object]) -> list[dict[str, object]]:
    """Candidates of a diagnosis, the best first.

    predicted: fall of chi^2 by the derivative, drop: once refitted; gain: in likelihood on unseen frames,
    error: its standard error; numbers: spent; struck: why, "" where it was not; None for what is not told.
    """
    ranked = {str(entry["effect"]): entry for entry in diagnosis["ranking"]}
    told = {str(row["effect"]): row for row in diagnosis.get("table") or ()}
    rows = [_row({**ranked.get(name, {}), **told.get(name, {})}) for name in dict.fromkeys((*told, *ranked))]
    # What was concluded in the end, as the simpler of two say, is not struck off, whatever was told before.
    return [row | {"struck": ""} if row["effect"] in diagnosis["effects"] else row for row in rows]


def _row(row: Mapping[str, object]) -> dict[str, object]:
    return {
        "effect": str(row["effect"]),
        "kind": str(row.get("kind", "")),
        "predicted": row.get("predicted_drop", row.get("statistic")),
        "drop": row.get("drop", row.get("refitted")),
        "gain": row.get("gain"),
        "error": row.get("gain_se"),
        "numbers": row.get("numbers"),
        "struck": str(row.get("struck") or row.get("reason") or ""),
        "p_value": row.get("p_value"),
        "estimate": row.get("estimate") or {},
        "std": row.get("std") or {},
        "ties": list(row.get("ties") or row.get("confounded_with") or ()),
    }


def ranking_chart(rows: Sequence[Mapping[str, object]], chosen: Sequence[str]) -> dict[str, object]:
    """Bars by candidate, the best at the top: how far the misfit would fall and, beside it where it was
    refitted, what it gained on unseen frames, with standard errors. chosen: effects
    concluded; hatched: struck off."""
    shown = [row for row in rows if row["predicted"] is not None][:RANKED][::-1]
    bars = [max(float(row["predicted"]), 0.0) for row in shown]
    falls = [*bars, *(float(row["drop"]) for row in shown if row["drop"] is not None)]
    wide = bool(falls) and max(falls) > 50.0 * max(min((f for f in falls if f > 0), default=1.0), 1e-9)
    looks = {
        "color": ["$unseen" if row["effect"] in chosen else "$fitted" for row in shown],
        "pattern": {"shape": ["/" if row["struck"] else "" for row in shown], "fgcolor": "$paper"},
        "opacity": [0.55 if row["struck"] else 1.0 for row in shown],
    }
    common = {
        "type": "bar",
        "orientation": "h",
        "y": [escape(row["effect"]) for row in shown],
        "marker": looks,
        "customdata": [[_hover(row)] for row in shown],
        "hovertemplate": "<b>%{y}</b>: %{x:.4g}<br>%{customdata[0]}<extra></extra>",
    }
    traces = [common | {"name": "by its derivative", "x": [max(b, 0.5) for b in bars] if wide else bars}]
    refits = [row for row in shown if row["drop"] is not None]
    if refits:
        traces.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "once it was refitted",
                "y": [escape(row["effect"]) for row in refits],
                "x": [row["drop"] for row in refits],
                "marker": {"symbol": "diamond", "size": 11, "color": "$ink"},
                "hovertemplate": "<b>%{y}</b>: the misfit really fell by %{x:.4g}<extra></extra>",
            }
        )
    axes = {"xaxis": {"title": {"text": "fall of the misfit (chi²)"}, "type": "log" if wide else "linear"}}
    if any(row["gain"] is not None for row in shown):
        axes["xaxis"]["domain"] = [0.0, 0.58]
        axes["xaxis2"] = {"title": {"text": "gain on unseen frames (log likelihood)"}, "domain": [0.64, 1.0]}
        errors = {"type": "data", "array": [row["error"] or 0.0 for row in shown], "color": "$ink"}
        gains = {"name": "gain ± standard error", "x": [row["gain"] for row in shown], "xaxis": "x2"}
        traces.append(common | gains | {"error_x": errors, "showlegend": False})
    margin = {"l": 150, "r": 24, "t": 40, "b": 56}
    height = 130 + 30 * len(shown)
    return figure("chart-ranking", height, traces, **axes, yaxis={"automargin": True}, margin=margin)


def _hover(row: Mapping[str, object]) -> str:
    lines = [
        f"{escape(name)} = {value:.4g}" + plus_minus(row["std"].get(name))
        for name, value in row["estimate"].items()
    ]
    if row["gain"] is not None:
        lines.append(f"gain on unseen frames {row['gain']:.4g}" + plus_minus(row["error"]))
    if row["numbers"] is not None:
        lines.append(f"numbers spent: {row['numbers']}")
    if row["p_value"] is not None:
        lines.append(f"p = {row['p_value']:.2g}")
    if row["ties"]:
        lines.append(f"not told apart from {escape(', '.join(row['ties']))}")
    if row["struck"]:
        lines.append(f"struck off: {escape(row['struck'])}")
    return "<br>".join(lines)


def plus_minus(std: float | None) -> str:
    return "" if std is None else f" ± {std:.2g}"


def intervals_chart(parameters: Mapping[str, Mapping[str, object]]) -> dict[str, object] | None:
    """How sure each parameter is: two standard errors either way over its value [%]; None without any."""
    known = [
        (key, entry, 200.0 * abs(entry["std"] / entry["value"]))
        for key, entry in parameters.items()
        if entry["std"] and entry["value"] and np.isfinite(entry["std"])
    ][::-1]
    if not known:
        return None
    trace = {
        "type": "scatter",
        "mode": "markers",
        "y": [escape(key) for key, _, _ in known],
        "x": [0.0] * len(known),
        "error_x": {"type": "data", "array": [min(p, 100.0) for *_, p in known], "thickness": 5, "width": 0,
                    "color": "$fitted"},
        "marker": {"size": 10, "color": "$ink",
                   "symbol": ["circle" if e["determined"] else "circle-open" for _, e, _ in known]},
        "customdata": [[e["value"], e["std"], escape(str(e["unit"])), p] for _, e, p in known],
        "hovertemplate": "<b>%{y}</b><br>%{customdata[0]:.4g} ± %{customdata[1]:.2g} %{customdata[2]}"
        "<br>two standard errors: %{customdata[3]:.3g} %<extra></extra>",
    }  # fmt: skip
    reach = 1.15 * max(min(p, 100.0) for *_, p in known)
    across = {"title": {"text": "two standard errors, % of the value (cut at 100)"}, "range": [-reach, reach]}
    margin = {"l": 190, "r": 24, "t": 16, "b": 56}
    return figure(
        "chart-intervals", 110 + 30 * len(known), [trace], xaxis=across, yaxis={"automargin": True},
        margin=margin, showlegend=False,
    )  # fmt: skip


def correlations_of(keys: Sequence[str], covariance: np.ndarray) -> np.ndarray:
    """(P, P) correlations of a covariance; NaN where a number has no spread."""
    spread = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    known = np.where(spread > 0, spread, np.nan)
    return np.clip(covariance / np.outer(known, known), -1.0, 1.0)


def correlation_chart(keys: Sequence[str], correlation: np.ndarray) -> dict[str, object] | None:
    """What the parameters trade with; None for fewer than two."""
    count = len(keys)
    if not 2 <= count <= CORRELATED:
        return None
    names = [escape(key) for key in keys]
    values = [[None if not np.isfinite(v) else round(float(v), 3) for v in row] for row in correlation]
    trace = {
        "type": "heatmap",
        "x": names,
        "y": names,
        "z": values,
        "zmin": -1,
        "zmax": 1,
        "colorscale": "$diverging",
        "xgap": 2,
        "ygap": 2,
        "hovertemplate": "%{y} and %{x}: %{z:.2f}<extra></extra>",
        "colorbar": {"title": {"text": "correlation"}, "thickness": 14, "tickvals": [-1, -0.5, 0, 0.5, 1]},
    }
    if count <= 10:
        trace |= {"texttemplate": "%{z:.2f}"}
    up = {"autorange": "reversed", "automargin": True}
    margin = {"l": 190, "r": 24, "t": 16, "b": 120}
    return figure(
        "chart-correlations", 210 + 34 * count, [trace], xaxis={"automargin": True, "tickangle": -35},
        yaxis=up, margin=margin,
    )  # fmt: skip


def budget_chart(budget: Mapping[str, float]) -> dict[str, object]:
    """One bar: shares of the mean square error. budget: root mean squares [m]."""
    words = {
        "noise": ("noise", "$quiet"),
        "discretisation": ("grid", "$grid"),
        "physics": ("model", "$unseen"),
    }
    total = max(sum(share**2 for share in budget.values()), 1e-30)
    traces = [
        {
            "type": "bar",
            "orientation": "h",
            "name": words[key][0],
            "y": [""],
            "x": [100.0 * share**2 / total],
            "marker": {"color": words[key][1]},
            "customdata": [[1e3 * share]],
            "hovertemplate": f"{words[key][0]}: %{{x:.1f}} % of the mean square, "
            "%{customdata[0]:.3f} mm rms<extra></extra>",
        }
        for key, share in budget.items()
    ]
    across = {"title": {"text": "% of the mean square error"}, "range": [0, 100]}
    margin = {"l": 24, "r": 24, "t": 40, "b": 56}
    return figure("chart-budget", 170, traces, barmode="stack", xaxis=across, margin=margin)
