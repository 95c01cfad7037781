"""Small pieces of HTML: tables, pictures, the viewer, and charts as SVG."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources

CONTROLS = """<div class="controls">
<select data-role="sequence" aria-label="sequence"></select>
<button data-role="play" type="button">play</button>
<input data-role="time" type="range" min="0" max="0" value="0" aria-label="time">
<span data-role="label"></span>
<label><input data-role="surface" type="checkbox" checked> surface</label>
<label><input data-role="measured" type="checkbox" checked> measured (rings)</label>
<label><input data-role="predicted" type="checkbox" checked> predicted (dots)</label>
<label data-role="force-label" hidden><input data-role="force" type="checkbox" checked> missing force</label>
<label><input data-role="turn" type="checkbox"> turn</label>
</div>"""


def asset(name: str) -> str:
    """The text of a file that belongs to this package."""
    return resources.files("mphygs.report").joinpath(name).read_text(encoding="utf-8")


def table(head: Sequence[str], rows: Sequence[Sequence[object]], classes: Sequence[str] = ()) -> str:
    """A table; numbers stand right. classes: of the rows."""
    lines = ["<table><thead><tr>", *(f"<th>{escape(cell)}</th>" for cell in head), "</tr></thead><tbody>"]
    for index, row in enumerate(rows):
        kind = f' class="{classes[index]}"' if classes and classes[index] else ""
        lines.append(f"<tr{kind}>")
        for cell in row:
            number = isinstance(cell, (int, float)) and not isinstance(cell, bool)
            text = f"{cell:.4g}" if isinstance(cell, float) else str(cell)
            lines.append(f'<td class="number">{escape(text)}</td>' if number else f"<td>{escape(text)}</td>")
        lines.append("</tr>")
    return "\n".join([*lines, "</tbody></table>"])


def picture(png: bytes, description: str) -> str:
    """A picture inside the page."""
    code = base64.b64encode(png).decode("ascii")
    return f'<img src="data:image/png;base64,{code}" alt="{escape(description)}">'


def script_data(value: object) -> str:
    """JSON that may stand inside a script element."""
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


def viewer(motions: Mapping[str, object]) -> str:
    """The turning view with its time slider; motions: sequence -> what `motion_document` made."""
    start = f'mphygsViewer(document.getElementById("viewer"), {script_data({"sequences": motions})})'
    return f"""<div class="viewer" id="viewer">
<canvas data-role="canvas"></canvas>
{CONTROLS}
</div>
<script>{asset("viewer.js")}</script>
<script>window.viewer = {start};</script>"""


def falling_errors(names: Sequence[str], series: Mapping[str, Sequence[float | None]]) -> str:
    """Errors over steps as SVG, logarithmic above the noise.

    names: of the steps; series: label -> rms over sigma per step, None where there is none.
    """
    values = [v for line in series.values() for v in line if v is not None and v > 0.0]
    if not values:
        return ""
    low, high = min(0.8, *values), max(1.25, *values) * 1.1
    width, height, left, bottom = 640, 260, 56, 44
    colours = ("#d1495b", "#2e6f95", "#4a7c59", "#8a5a9e", "#b07d3c", "#555555")

    def across(step: int) -> float:
        return left + (width - left - 170) * (step / max(len(names) - 1, 1))

    def up(value: float) -> float:
        return 12 + (height - bottom - 12) * (1 - math.log(value / low) / math.log(high / low))

    parts = [f'<svg id="falling" viewBox="0 0 {width} {height}" width="{width}" role="img" font-size="12">']
    ends = f'x1="{left}" x2="{width - 160}" y1="{up(1):.1f}" y2="{up(1):.1f}"'
    parts.append(f'<line {ends} stroke="#999" stroke-dasharray="4"/>')
    parts.append(f'<text x="4" y="{up(1) + 4:.1f}" fill="#666">noise</text>')
    for step, name in enumerate(names):
        parts.append(
            f'<text x="{across(step):.1f}" y="{height - 20}" text-anchor="middle">{escape(name)}</text>'
        )
    for line, colour in zip(series.values(), colours * len(series), strict=False):
        points = [(across(k), up(v)) for k, v in enumerate(line) if v is not None and v > 0.0]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{colour}" stroke-width="2"/>')
        parts += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>' for x, y in points]
        shown = [(k, v) for k, v in enumerate(line) if v is not None]
        parts += [
            f'<text x="{across(k) + 6:.1f}" y="{up(v) - 6:.1f}" fill="{colour}">{v:.2f}</text>'
            for k, v in shown
            if v > 0
        ]
    for row, (label, colour) in enumerate(zip(series, colours * len(series), strict=False)):
        y = 24 + 18 * row
        parts.append(f'<rect x="{width - 150}" y="{y - 9}" width="10" height="10" fill="{colour}"/>')
        parts.append(f'<text x="{width - 134}" y="{y}">{escape(label)}</text>')
    return "\n".join([*parts, "</svg>"])
