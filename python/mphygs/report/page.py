"""The page: what was measured, fitted and predicted, where it fails, what is missing, and how it was made."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape

from mphygs.capture.format import Capture
from mphygs.compare.assess import in_words
from mphygs.diagnose.document import seen_from, spot_lines
from mphygs.fit.run import Run
from mphygs.report.html import asset, falling_errors, picture, table, viewer

RANKED = 10


@dataclass(frozen=True, eq=False, kw_only=True)
class Contents:
    """All that a page tells.

    parameters, comparison, diagnosis, steps: as the commands print them, None for what was not run;
    pictures: .png by sequence; motions: for the viewer by sequence; commands: that made it; force: what is
    said of the missing force, line by line.
    """

    run: Run
    capture: Capture
    parameters: Mapping[str, Mapping[str, object]]
    comparison: Mapping[str, object]
    pictures: Mapping[str, bytes]
    motions: Mapping[str, object]
    commands: Sequence[str]
    diagnosis: Mapping[str, object] | None = None
    steps: Mapping[str, object] | None = None
    force: Sequence[str] = ()


def page(contents: Contents) -> str:
    """One self-contained HTML document."""
    name = escape(contents.capture.name)
    sections = (
        ("measured", "What was measured", _measured(contents)),
        ("fitted", "What was fitted", _fitted(contents)),
        ("prediction", "Prediction beside measurement", _prediction(contents)),
        ("where", "Where and when it fails", _where(contents)),
        ("ranking", "What could be missing", _ranking(contents)),
        ("steps", "The error, step by step", _steps(contents)),
        ("force", "The missing force", _force(contents)),
        ("commands", "The commands that made it", f"<pre>{escape(chr(10).join(contents.commands))}</pre>"),
    )
    body = "\n".join(
        f'<section id="{key}"><h2>{title}</h2>\n{text}</section>' for key, title, text in sections
    )
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>mphygs: {name}</title>
<meta name="viewport" content="width=device-width, initial-scale=1">
<style>{asset("style.css")}</style></head><body>
<h1>{name}</h1>
{_verdict(contents)}
{body}
</body></html>
"""


def _verdict(contents: Contents) -> str:
    comparison = contents.comparison
    noise = in_words(comparison["adequate"], comparison["p_value"])
    text = f"The misfit of this model is {noise} (p = {comparison['p_value']:.2g})."
    kind = "adequate" if comparison["adequate"] else "unknown"
    for found in (contents.steps, contents.diagnosis):
        if found is not None and found.get("verdict"):
            names = ", ".join(found.get("effects", ())) or "none"
            text += f" Verdict: {found['verdict']}; effects: {names}."
            kind = found["verdict"]
            break
    return f'<p class="verdict {escape(kind)}" id="verdict">{escape(text)}</p>'


def _measured(contents: Contents) -> str:
    capture = contents.capture
    parts = [[part.name, 1e6 * part.volume] for part in capture.parts]
    rows = []
    for recording in capture.sequences:
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


def _fitted(contents: Contents) -> str:
    rows, classes = [], []
    for key, entry in contents.parameters.items():
        remark = str(entry.get("note", ""))
        if not entry["determined"]:
            remark = f"not determined: {remark}"
        std = entry["std"]
        rows.append([key, entry["value"], std if std is not None else "unbounded", entry["unit"], remark])
        classes.append("" if entry["determined"] else "undetermined")
    run = contents.run
    used = ", ".join(f"{name} frames {a} to {b}" for name, (a, b) in run.ranges.items())
    effects = ", ".join(run.belief.effects) or "none"
    facts = (
        f"<p>{escape(run.belief.law)}, prestress {escape(run.belief.prestress)}, effects: {escape(effects)}; "
        f"grid {1e3 * run.settings.spacing:.3g} mm, {escape(run.transfer)}; fitted on {escape(used)}.</p>"
    )
    return facts + table(["parameter", "value", "standard error", "unit", ""], rows, classes)


def _errors(sequences: Mapping[str, Mapping[str, Mapping[str, float] | None]]) -> str:
    told = [
        (name, label, error)
        for name, ranges in sequences.items()
        for label, error in ranges.items()
        if error is not None
    ]
    rows = [
        [name, label, 1e3 * error["rms"], 1e3 * error["max"], error["rms_over_sigma"], error["count"]]
        for name, label, error in told
        if error["rms"] is not None
    ]
    out = table(["sequence", "frames", "rms mm", "max mm", "rms / sigma", "points"], rows)
    drawn = [
        [name, label, error["psnr"], 100 * error["iou"], error["chamfer_px"]]
        for name, label, error in told
        if "psnr" in error
    ]
    return out + (table(["sequence", "frames", "PSNR dB", "IoU %", "chamfer px"], drawn) if drawn else "")


def _prediction(contents: Contents) -> str:
    pieces = [_errors(contents.comparison["sequences"]), viewer(contents.motions)]
    pieces += [picture(png, f"{name}: measured and predicted") for name, png in contents.pictures.items()]
    return "\n".join(pieces)


def _where(contents: Contents) -> str:
    comparison = contents.comparison
    budget = table(["share", "rms mm"], [[name, 1e3 * share] for name, share in comparison["budget"].items()])
    if not comparison["where"] and not comparison["when"]:
        return "<p>Nowhere and never more than noise.</p>" + budget
    where = [
        [entry["part"], ", ".join(f"{1e3 * x:.1f}" for x in entry["center"]), 1e3 * entry["rms"]]
        for entry in comparison["where"]
    ]
    when = [
        [entry.get("sequence", ""), f"{entry['frames'][0]} to {entry['frames'][1]}", 1e3 * entry["rms"]]
        for entry in comparison["when"][:12]
    ]
    return (
        budget
        + table(["part", "centre mm", "rms mm beyond noise"], where)
        + table(["sequence", "frames", "rms mm beyond noise"], when)
    )


def _ranking(contents: Contents) -> str:
    found = contents.diagnosis
    if found is None:
        return f'<p class="quiet">Not diagnosed yet: mphygs diagnose {escape(str(contents.run.folder))}</p>'
    rows = []
    for entry in found["ranking"][:RANKED]:
        estimate = ", ".join(f"{key} {value:.4g}" for key, value in entry["estimate"].items())
        reason = entry.get("reason") or ", ".join(entry["confounded_with"])
        expected = entry["expected_rms"]
        rows.append(
            [
                entry.get("way", entry["effect"]),
                entry["kind"],
                float(entry["statistic"]),
                float(entry["p_value"]),
                "" if expected is None else 1e3 * expected,
                estimate,
                seen_from(entry),
                reason,
            ]
        )
    head = [
        "candidate",
        "kind",
        "chi² falls by",
        "p",
        "rms then, mm",
        "estimate",
        "seen from",
        "not told apart from, or why not",
    ]
    spots = "\n".join(spot_lines(found)[1:])
    told = f"<pre>{escape(spots)}</pre>" if spots else ""
    return table(head, rows) + told + f"<p>{escape(str(found['advice']))}</p>"


def _steps(contents: Contents) -> str:
    found = contents.steps
    if found is None:
        return '<p class="quiet">One model so far: extend or discover add steps.</p>'
    names, series = [], {}
    for step in found["steps"]:
        names.append("+ " + ", ".join(step["added"]) if step["added"] else "before")
        for sequence, ranges in step["sequences"].items():
            for label in ("fit", "predict"):
                if ranges[label] is not None:
                    series.setdefault(f"{sequence}, {label}", []).append(ranges[label]["rms_over_sigma"])
    rows = []
    for step, name in zip(found["steps"], names, strict=True):
        for sequence, ranges in step["sequences"].items():
            for label in ("fit", "predict"):
                if ranges[label] is not None:
                    error = ranges[label]
                    rows.append([name, sequence, label, 1e3 * error["rms"], error["rms_over_sigma"]])
    chart = falling_errors(names, series)
    return chart + table(["step", "sequence", "frames", "rms mm", "rms / sigma"], rows)


def _force(contents: Contents) -> str:
    found = None if contents.diagnosis is None else contents.diagnosis.get("missing_force")
    if not found:
        return '<p class="quiet">Not computed: it is where named effects do not explain the misfit.</p>'
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
    pieces = [said, "<p>Arrows in the view above show it over time, on the fitted frames.</p>"]
    pieces.append(table(["part", "rms N/kg", "share of the square"], where))
    pieces.append(table(["sequence", "frames with half of the square", "rms N/kg"], when))
    if terms:
        head = ["term", "coefficient", "standard error", "unit", "chosen in this share of the resamples"]
        pieces.append(table(head, terms))
    return "\n".join(pieces)
