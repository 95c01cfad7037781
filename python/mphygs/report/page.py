"""The page: the verdict, how the error fell, where it is, what it is made of, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from mphygs.compare.sensor_residuals import sensor_lines
from mphygs.report import charts
from mphygs.report.evidence import parameters, ranking
from mphygs.report.film_frames import wipe
from mphygs.report.html import asset, chart, folded, html_table, scene, scripts
from mphygs.report.page_contents import Contents
from mphygs.report.verdict import concluded, tiles, verdict_sentence


def report_page(contents: Contents) -> str:
    """One self-contained HTML document."""
    figures: list[dict[str, object]] = []
    sections = (
        ("fall", "How the error fell", _fall(contents, figures)),
        ("object", "The object", _object(contents)),
        ("moments", "Which marker, which frame", _moments(contents)),
        ("sensors", "Forces and accelerations", _sensors(contents, figures)),
        ("ranking", "What could be missing", ranking(contents, figures)),
        ("parameters", "The numbers found", parameters(contents, figures)),
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


def document(name: str, body: str, data: object, *extra_files: str) -> str:
    """A page around its body. data, extra_files: see `scripts`."""
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>mphygs: {escape(name)}</title>
<link rel="icon" href="data:,"><meta name="viewport" content="width=device-width, initial-scale=1">
<style>{asset("style.css")}</style></head><body>
<p id="failed" class="verdict" hidden>Charts cannot be drawn in this browser (it takes WebGL and
DecompressionStream: any of 2023 or later). Tables and text are complete without them.</p>
{body}
{scripts(data, *extra_files)}
</body></html>
"""


def _verdict(contents: Contents) -> str:
    known = contents.comparison, contents.steps, contents.diagnosis
    verdict, effects = concluded(*known)
    text = verdict_sentence(contents.capture.name, *known)
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
    pictures = html_table(["sequence", "frames", "PSNR dB", "IoU %", "chamfer px"], drawn) if drawn else ""
    words = "1 is the noise alone; a line that falls for unseen frames as for fitted ones is no bent curve."
    return (
        f'<p class="quiet">{words}</p>{quiet}{chart("chart-fall", "errors by model")}'
        + folded("the same as a table", html_table(head, rows))
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
    return f'<p class="quiet">{escape(words + left)}</p>{scene()}<div class="films">{films}</div>'


def _moments(contents: Contents) -> str:
    words = "Of the sequence chosen above; a click goes to its frame. The dotted line ends what was fitted."
    return (
        f'<p class="quiet">{words}</p>{chart("chart-heat", "error by marker and frame")}'
        f"{chart('chart-curves', 'two markers over time')}{_when(contents.comparison)}"
    )


def _sensors(contents: Contents, figures: list) -> str:
    if contents.sensors is None:
        return ""
    figures.append(dict(contents.sensors))
    head, *rows = sensor_lines(contents.comparison.get("sensors", {}))
    words = (
        "Marks are measured, lines predicted, shaded frames were fitted. A force is what the hold exerts on "
        "the object, a torque that about the centre of its box."
    )
    return (
        f'<p class="quiet">{words}</p>{chart("chart-sensors", "what instruments measured, and predicted")}'
        + folded("how far off as a table", html_table(head, rows))
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
        html_table(["part", "centre mm", "rms mm beyond noise"], where)
        + html_table(["sequence", "frames", "rms mm beyond noise"], when),
    )


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
        + folded("in mm", html_table(["share", "rms mm"], rows))
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
    words = "Arrows on the object above show it over time, on the fitted frames, where it was measured."
    pieces = [said, f"<p>{words}</p>"]
    pieces.append(html_table(["part", "rms N/kg", "share of the square"], where))
    pieces.append(html_table(["sequence", "frames with half of the square", "rms N/kg"], when))
    if terms:
        head = ["term", "coefficient", "standard error", "unit", "chosen in this share of the resamples"]
        pieces.append(html_table(head, terms))
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
    return html_table(["part", "volume cm³"], parts) + html_table(head, rows)
