"""Small pieces of HTML: tables, data for scripts, and the drawing library, packed."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Sequence
from functools import cache
from html import escape
from importlib import resources

CONTROLS = """<div class="controls">
<select data-role="sequence" aria-label="sequence"></select>
<button data-role="play" type="button">play</button>
<input data-role="time" type="range" min="0" max="0" value="0" aria-label="frame">
</div><div class="controls">
<span class="switch" data-role="shape" role="radiogroup" aria-label="shape">
<label><input type="radio" name="shape" value="predicted" checked> predicted</label>
<label><input type="radio" name="shape" value="measured"> measured</label>
<label><input type="radio" name="shape" value="both"> flip by itself</label></span>
<span class="switch" data-role="model" role="radiogroup" aria-label="model"></span>
<label><select data-role="paint" aria-label="paint"><option value="error">paint the error</option>
<option value="part">paint the parts</option></select></label>
<label><input data-role="points" type="checkbox" checked> markers</label>
<label data-role="force-label" hidden><input data-role="force" type="checkbox" checked> missing force</label>
<button data-role="home" type="button">view from the side</button>
</div><p class="label" data-role="label"></p>"""


def asset(name: str) -> str:
    """The text of a file that belongs to this package."""
    return resources.files("mphygs.report").joinpath(name).read_text(encoding="utf-8")


def four_digits(value: float) -> str:
    """Four digits."""
    return f"{value:.4g}"


def html_table(head: Sequence[str], rows: Sequence[Sequence[object]], classes: Sequence[str] = ()) -> str:
    """A table; numbers stand right. classes: of the rows."""
    lines = ["<table><thead><tr>", *(f"<th>{escape(cell)}</th>" for cell in head), "</tr></thead><tbody>"]
    for index, row in enumerate(rows):
        kind = f' class="{classes[index]}"' if classes and classes[index] else ""
        lines.append(f"<tr{kind}>")
        for cell in row:
            numeric = isinstance(cell, (int, float)) and not isinstance(cell, bool)
            text = four_digits(cell) if isinstance(cell, float) else str(cell)
            lines.append(f'<td class="number">{escape(text)}</td>' if numeric else f"<td>{escape(text)}</td>")
        lines.append("</tr>")
    return "\n".join([*lines, "</tbody></table>"])


def folded(summary: str, content: str) -> str:
    """What is shown once it is asked for, and in print."""
    return f"<details><summary>{escape(summary)}</summary>{content}</details>"


def chart(identifier: str, description: str) -> str:
    """The place of a chart."""
    return f'<div class="chart" id="{identifier}" role="img" aria-label="{escape(description)}"></div>'


def script_data(value: object) -> str:
    """JSON that may stand inside a script element."""
    return json.dumps(value, allow_nan=False).replace("<", "\\u003c")


@cache
def plotly_script() -> str:
    """plotly.js (MIT licence) as gzip in base64: a page unpacks it without a network."""
    content = resources.files("plotly").joinpath("package_data/plotly.min.js").read_bytes()
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode("ascii")


def scene() -> str:
    """The place of the object in 3D, of the chart by marker and frame, and of the curves."""
    return f"""<div class="scene" id="scene"><div class="canvas" data-role="canvas"></div>
{CONTROLS}</div>"""


def scripts(data: object, *extra_files: str) -> str:
    """What draws a page. data: {"charts": figures, "scene", "films"}; extra_files: files that follow."""
    files = ("page.js", "scene.js", "moments.js", "wipe.js", *extra_files)
    return f"""<script type="text/plain" id="library">{plotly_script()}</script>
<script type="application/json" id="data">{script_data(data)}</script>
<script>{"".join(asset(name) for name in files)}
mphygsPage();</script>"""
