"""Two sections of the page: what could be missing, and the numbers found."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

import numpy as np

from mphygs.diagnose.diagnosis_document import seen_from, spot_lines
from mphygs.fit.determined import of_unit_length
from mphygs.report import charts
from mphygs.report.html import chart, folded, four_digits, html_table
from mphygs.report.page_contents import Contents

# A correlation above this is told of a parameter.
TRADES = 0.6


def ranking(contents: Contents, figures: list) -> str:
    """What could be missing, the best candidate first; its chart is added to the figures."""
    found = contents.diagnosis if contents.diagnosis is not None else contents.diagnosis_before
    if found is None:
        return '<p class="quiet">Not diagnosed yet: mphygs diagnose.</p>'
    rows = charts.ranking_rows(found)
    if not rows:
        return '<p class="quiet">No candidate was scored.</p>'
    figures.append(charts.ranking_chart(rows, found["effects"]))
    seen = {str(entry["effect"]): seen_from(entry) for entry in found["ranking"]}
    lines = []
    for row in rows:
        numbers = ", ".join(
            f"{name} {four_digits(value)}" + charts.plus_minus(row["std"].get(name))
            for name, value in row["estimate"].items()
        )
        told = [row["struck"], ", ".join(row["ties"])]
        lines.append(
            [row["effect"], row["kind"], _cell(row["predicted"]), _cell(row["p_value"]), _cell(row["drop"]),
             _cell(row["gain"]), _cell(row["error"]), numbers, seen.get(row["effect"], ""), *told]
        )  # fmt: skip
    head = [
        "candidate", "kind", "chi² falls by", "p", "refitted, falls by", "gain on unseen", "its error",
        "estimate", "seen from", "struck off, why", "not told apart from",
    ]  # fmt: skip
    spots = "\n".join(spot_lines(found)[1:])
    struck = [[row["effect"], row["struck"]] for row in rows if row["struck"]]
    off = "<h3>Struck off, and why</h3>" + html_table(["candidate", "reason"], struck) if struck else ""
    words = "How far the misfit would fall with each candidate. Orange: concluded; hatched: struck off."
    if contents.diagnosis is None:
        words = "What was found of the model before, from which this one was extended. " + words
    return (
        f'<p class="quiet">{words}</p>{chart("chart-ranking", "fall of the misfit by candidate")}{off}'
        + folded("all candidates as a table", html_table(head, lines))
        + (folded("where and when it is wanted", f"<pre>{escape(spots)}</pre>") if spots else "")
    )


def _cell(value: object) -> object:
    return "" if value is None else float(value)


def parameters(contents: Contents, figures: list) -> str:
    """The numbers found, how sure they are and what they trade with; charts are added to the figures."""
    run = contents.run
    free, _, covariance = of_unit_length(run.belief.free, run.information, run.covariance)
    keys = [p.key for p in free]
    logarithms = {p.key for p in free if p.log}
    correlation = charts.correlations_of(keys, covariance)
    trades = _trades(keys, correlation)
    rows, classes = [], []
    for key, entry in contents.parameters.items():
        remark = str(entry.get("note", ""))
        if not entry["determined"]:
            remark = f"not determined: {remark}"
        std = entry["std"]
        between = entry.get("interval") or two_errors(entry["value"], std, log=key in logarithms)
        span = " to ".join(four_digits(end) for end in between)
        rows.append(
            [key, entry["value"], std if std is not None else "unbounded", span, entry["unit"],
             trades.get(key, ""), remark]
        )  # fmt: skip
        classes.append("" if entry["determined"] else "undetermined")
    used = ", ".join(f"{name} frames {a} to {b}" for name, (a, b) in run.ranges.items())
    effects = ", ".join(run.belief.effects) or "none"
    facts = (
        f'<p class="quiet">{escape(run.belief.law)}, prestress {escape(run.belief.prestress)}, effects: '
        f"{escape(effects)}; grid {1e3 * run.settings.spacing:.3g} mm, {escape(run.transfer)}; fitted on "
        f"{escape(used)}.</p>"
    )
    pieces = [facts]
    head = ["parameter", "value", "standard error", "two standard errors", "unit", "trades with", ""]
    pieces.append(html_table(head, rows, classes))
    for figure, words in (
        (charts.intervals_chart(contents.parameters), "how sure each parameter is"),
        (charts.correlation_chart(keys, correlation), "correlations of the parameters"),
    ):
        if figure is not None:
            figures.append(figure)
            pieces.append(chart(str(figure["id"]), words))
    return "".join(pieces)


def two_errors(value: float, std: float | None, *, log: bool) -> list[float]:
    """Two standard errors either way, in the logarithm of a number that is fitted in it; [] without any."""
    if std is None:
        return []
    if log:
        return [value * math.exp(-2.0 * std / value), value * math.exp(min(2.0 * std / value, 700.0))]
    return [value - 2.0 * std, value + 2.0 * std]


def _trades(keys: Sequence[str], correlation: np.ndarray) -> dict[str, str]:
    """What each parameter is most correlated with, where that is much."""
    found = {}
    for k, key in enumerate(keys):
        others = [(abs(c), other, c) for other, c in zip(keys, correlation[k], strict=True) if other != key]
        best = max((item for item in others if np.isfinite(item[0])), default=None)
        if best is not None and best[0] >= TRADES:
            found[key] = f"{best[1]} ({best[2]:+.2f})"
    return found
