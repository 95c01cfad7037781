"""The page: the verdict, how the error fell, where it is, what it is made of, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from html import escape

import numpy as np

from mphygs.capture.format import Capture
from mphygs.diagnose.document import seen_from, spot_lines
from mphygs.fit.determined import of_unit_length
from mphygs.fit.run import Run
from mphygs.report import charts
from mphygs.report.filmed import wipe
from mphygs.report.html import asset, chart, folded, number, scene, scripts, table
from mphygs.report.verdict import concluded, sentence, tiles

# A correlation above this is told of a parameter.
TRADES = 0.6


@dataclass(frozen=True, eq=False, kw_only=True)
class Contents:
    """All that a page tells.

    parameters, comparison, diagnosis, steps: as the commands print them, None for what was not run; scene:
    see `scene_document`; films: video beside rendering by sequence; commands: that made it; force: what is
    said of the missing force, line by line; hidden: sequences that the scene has no room for.
    """

    run: Run
    capture: Capture
    parameters: Mapping[str, Mapping[str, object]]
    comparison: Mapping[str, object]
    scene: Mapping[str, object]
    commands: Sequence[str]
    films: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    diagnosis: Mapping[str, object] | None = None
    steps: Mapping[str, object] | None = None
    force: Sequence[str] = ()
    hidden: Sequence[str] = ()


def page(contents: Contents) -> str:
    """One self-contained HTML document."""
    figures: list[dict[str, object]] = []
    sections = (
        ("fall", "How the error fell", _fall(contents, figures)),
        ("object", "The object", _object(contents)),
        ("moments", "Which marker, which frame", _moments(contents)),
        ("ranking", "What could be missing", _ranking(contents, figures)),
        ("parameters", "The numbers found", _parameters(contents, figures)),
        ("budget", "Where the error comes from", _budget(contents, figures)),
        ("force", "The missing force", _force(contents)),
        ("next", "What to do next", _next(contents)),
        ("measured", "What was measured", _measured(contents)),
        ("commands", "The commands that made it", f"<pre>{escape(chr(10).join(contents.commands))}</pre>"),
    )
    body = "\n".join(
        f'<section id="{key}"><h2>{title}</h2>\n{text}</section>' for key, title, text in sections if text
    )
    data = {"charts": figures, "scene": contents.scene, "films": list(contents.films.values())}
    head = f"<h1>{escape(contents.capture.name)}</h1>\n{_verdict(contents)}\n"
    return document(contents.capture.name, head + body, data)


def document(name: str, body: str, data: object, *more: str) -> str:
    """A page around its body. data, more: see `scripts`."""
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>mphygs: {escape(name)}</title>
<link rel="icon" href="data:,"><meta name="viewport" content="width=device-width, initial-scale=1">
<style>{asset("style.css")}</style></head><body>
<p id="failed" class="verdict" hidden>Charts cannot be drawn in this browser (it takes WebGL and
DecompressionStream: any of 2023 or later). Tables and text are complete without them.</p>
{body}
{scripts(data, *more)}
</body></html>
"""


def _verdict(contents: Contents) -> str:
    known = contents.comparison, contents.steps, contents.diagnosis
    verdict, effects = concluded(*known)
    text = sentence(contents.capture.name, *known)
    small = f"Verdict: {verdict}; effects: {', '.join(effects) or 'none'}."
    numbers = "".join(
        f'<div class="tile"><b>{escape(value)}</b><span>{escape(words)}</span></div>'
        for value, words in tiles(contents.comparison, contents.steps)
    )
    return (
        f'<p class="verdict {escape(verdict.replace(" ", "-"))}" id="verdict">{escape(text)}<br>'
        f'<span class="quiet">{escape(small)}</span></p><div class="tiles">{numbers}</div>'
    )


def _fall(contents: Contents, figures: list) -> str:
    told = contents.steps["steps"] if contents.steps is not None else []
    if told:
        titles = [charts.title_of(step, not k) for k, step in enumerate(told)]
        sequences = [step["sequences"] for step in told]
    else:
        titles = [", ".join(contents.run.belief.effects) or "elasticity alone"]
        sequences = [contents.comparison["sequences"]]
    figures.append(charts.fall_chart(titles, sequences, contents.comparison["budget"]))
    rows = []
    for title, errors in zip(titles, sequences, strict=True):
        rows += [[title, *row] for row in _error_rows(errors)]
    head = ["model", "sequence", "frames", "rms mm", "max mm", "rms / sigma", "points"]
    quiet = "" if len(told) > 1 else '<p class="quiet">One model so far: extend or discover add steps.</p>'
    drawn = [
        [name, label, error["psnr"], 100 * error["iou"], error["chamfer_px"]]
        for name, ranges in contents.comparison["sequences"].items()
        for label, error in ranges.items()
        if error is not None and "psnr" in error
    ]
    pictures = table(["sequence", "frames", "PSNR dB", "IoU %", "chamfer px"], drawn) if drawn else ""
    words = "1 is the noise alone; a line that falls for unseen frames as for fitted ones is no bent curve."
    return (
        f'<p class="quiet">{words}</p>{quiet}{chart("chart-fall", "errors by model")}'
        + folded("the same as a table", table(head, rows))
        + pictures
    )


def _error_rows(sequences: Mapping[str, Mapping[str, Mapping[str, float] | None]]) -> list[list[object]]:
    return [
        [name, charts.RANGES[label][0], 1e3 * e["rms"], 1e3 * e["max"], e["rms_over_sigma"], e["count"]]
        for name, ranges in sequences.items()
        for label, e in ranges.items()
        if e is not None and label in charts.RANGES and e["rms"] is not None
    ]


def _object(contents: Contents) -> str:
    words = (
        "Painted is how far measured is from predicted, between markers as the nearest ones have it; the "
        "measured shape is the predicted one carried to the markers."
    )
    left = f" Not shown for lack of room: {', '.join(contents.hidden)}." if contents.hidden else ""
    films = "".join(
        wipe(str(film["id"]), f"{escape(name)}: video | rendering") for name, film in contents.films.items()
    )
    return f'<p class="quiet">{escape(words + left)}</p>{scene()}{films}'


def _moments(contents: Contents) -> str:
    words = "Of the sequence chosen above; a click goes to its frame. The dotted line ends what was fitted."
    return (
        f'<p class="quiet">{words}</p>{chart("chart-heat", "error by marker and frame")}'
        f"{chart('chart-curves', 'two markers over time')}{_when(contents.comparison)}"
    )


def _when(comparison: Mapping[str, object]) -> str:
    if not comparison["where"] and not comparison["when"]:
        return "<p>Nowhere and never more than noise.</p>"
    where = [
        [entry["part"], ", ".join(f"{1e3 * x:.1f}" for x in entry["center"]), 1e3 * entry["rms"]]
        for entry in comparison["where"]
    ]
    when = [
        [entry.get("sequence", ""), f"{entry['frames'][0]} to {entry['frames'][1]}", 1e3 * entry["rms"]]
        for entry in comparison["when"][:12]
    ]
    return folded(
        "parts and frames whose error is more than noise",
        table(["part", "centre mm", "rms mm beyond noise"], where)
        + table(["sequence", "frames", "rms mm beyond noise"], when),
    )


def _ranking(contents: Contents, figures: list) -> str:
    found = contents.diagnosis
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
            f"{name} {number(value)}" + charts.spread_of(row["std"].get(name))
            for name, value in row["estimate"].items()
        )
        told = [row["struck"], ", ".join(row["ties"])]
        gain = None if row["gain"] is None else float(row["gain"])
        lines.append(
            [row["effect"], row["kind"], _cell(gain), _cell(row["error"]), _cell(row["p_value"]),
             _cell(row["refitted"]), numbers, seen.get(row["effect"], ""), *told]
        )  # fmt: skip
    head = [
        "candidate", "kind", "chi² falls by", "standard error", "p", "refitted, falls by", "estimate",
        "seen from", "struck off, why", "not told apart from",
    ]  # fmt: skip
    spots = "\n".join(spot_lines(found)[1:])
    struck = [[row["effect"], row["struck"]] for row in rows if row["struck"]]
    off = "<h3>Struck off, and why</h3>" + table(["candidate", "reason"], struck) if struck else ""
    words = "How far the misfit would fall with each candidate. Orange: concluded; hatched: struck off."
    return (
        f'<p class="quiet">{words}</p>{chart("chart-ranking", "fall of the misfit by candidate")}{off}'
        + folded("all candidates as a table", table(head, lines))
        + (folded("where and when it is wanted", f"<pre>{escape(spots)}</pre>") if spots else "")
    )


def _cell(value: object) -> object:
    return "" if value is None else float(value)


def _parameters(contents: Contents, figures: list) -> str:
    run = contents.run
    free, _, covariance = of_unit_length(run.belief.free, run.information, run.covariance)
    keys = [p.key for p in free]
    correlation = charts.correlations_of(keys, covariance)
    trades = _trades(keys, correlation)
    rows, classes = [], []
    for key, entry in contents.parameters.items():
        remark = str(entry.get("note", ""))
        if not entry["determined"]:
            remark = f"not determined: {remark}"
        std = entry["std"]
        between = entry.get("interval") or (
            [entry["value"] - 2 * std, entry["value"] + 2 * std] if std is not None else []
        )
        span = " to ".join(number(end) for end in between)
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
    pieces.append(table(head, rows, classes))
    for figure, words in (
        (charts.intervals_chart(contents.parameters), "how sure each parameter is"),
        (charts.correlation_chart(keys, correlation), "correlations of the parameters"),
    ):
        if figure is not None:
            figures.append(figure)
            pieces.append(chart(str(figure["id"]), words))
    return "".join(pieces)


def _trades(keys: Sequence[str], correlation: np.ndarray) -> dict[str, str]:
    """What each parameter is most correlated with, where that is much."""
    found = {}
    for k, key in enumerate(keys):
        others = [(abs(c), other, c) for other, c in zip(keys, correlation[k], strict=True) if other != key]
        best = max((item for item in others if np.isfinite(item[0])), default=None)
        if best is not None and best[0] >= TRADES:
            found[key] = f"{best[1]} ({best[2]:+.2f})"
    return found


def _budget(contents: Contents, figures: list) -> str:
    budget = contents.comparison["budget"]
    figures.append(charts.budget_chart(budget))
    shares = {"noise": "noise", "discretisation": "grid", "physics": "model"}
    rows = [[shares[name], 1e3 * share] for name, share in budget.items()]
    words = "The shares add in squares; the grid's is what a finer one would change and a refit not absorb."
    note = f'<p class="quiet">{words}</p>'
    return (
        note
        + chart("chart-budget", "shares of the error")
        + folded("in mm", table(["share", "rms mm"], rows))
    )


def _force(contents: Contents) -> str:
    found = None if contents.diagnosis is None else contents.diagnosis.get("missing_force")
    if not found:
        return ""
    said = f"<pre>{escape(chr(10).join(contents.force))}</pre>" if contents.force else ""
    where = [[entry["part"], entry["rms"], entry["share"]] for entry in found["where"]]
    when = [
        [entry["sequence"], f"{entry['frames'][0]} to {entry['frames'][1] - 1}", entry["rms"]]
        for entry in found["when"]
    ]
    terms = [
        [term["expression"], term["coefficient"], term["std"], term["unit"], term["stability"]]
        for term in found["terms"]
    ]
    pieces = [said, "<p>Arrows on the object above show it over time, on the fitted frames.</p>"]
    pieces.append(table(["part", "rms N/kg", "share of the square"], where))
    pieces.append(table(["sequence", "frames with half of the square", "rms N/kg"], when))
    if terms:
        head = ["term", "coefficient", "standard error", "unit", "chosen in this share of the resamples"]
        pieces.append(table(head, terms))
    return "\n".join(pieces)


def _next(contents: Contents) -> str:
    lines = [str(contents.diagnosis["advice"])] if contents.diagnosis is not None else []
    steps = contents.steps or {}
    told = steps.get("steps") or [{}]
    concluded_effects = list(steps.get("effects") or ())
    if concluded_effects and len(told) > 1 and contents.comparison["adequate"]:
        lines = [f"{', '.join(concluded_effects)} is in this model, and the error is at its floor."]
    lines += [f"Warning: {line}." for line in steps.get("warnings") or ()]
    for step in told:
        if step.get("ties"):
            lines.append(
                f"The motions recorded do not tell {', '.join(step['added'])} from {', '.join(step['ties'])}"
                ": record one with another amplitude, frequency or direction of gravity, and fit both."
            )
    loose = [key for key, entry in contents.parameters.items() if not entry["determined"]]
    if loose:
        lines.append(f"Not determined by what was recorded: {', '.join(loose)}.")
    if contents.diagnosis is None and not contents.comparison["adequate"]:
        lines.append(f"Ask what is missing: mphygs diagnose {contents.run.folder}")
    if not lines:
        lines.append("Nothing: the error is noise and the grid's share.")
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"


def _measured(contents: Contents) -> str:
    parts = [[part.name, 1e6 * part.volume] for part in contents.capture.parts]
    rows = []
    for recording in contents.capture.sequences:
        markers = recording.markers
        rows.append(
            [
                recording.name,
                recording.frames,
                float(recording.fps),
                0 if markers is None else markers.position.shape[1],
                "" if markers is None else 1e3 * markers.sigma,
                f"{recording.fit[0]} to {recording.fit[1]}",
                f"{recording.predict[0]} to {recording.predict[1]}",
                "" if recording.release is None else recording.release,
            ]
        )
    head = ["sequence", "frames", "per s", "markers", "sigma mm", "fit", "predict", "release"]
    return table(["part", "volume cm³"], parts) + table(head, rows)
