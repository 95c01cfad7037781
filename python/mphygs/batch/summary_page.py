"""The table of a batch as one HTML file, which sorts by a click on any head, without a network."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape
from importlib import resources
from urllib.parse import quote

from mphygs.batch.summary import ERRORS, RANGES, Row, keys_of
from mphygs.report.html import asset, four_digits

_UNITS = {"rms": "rms m", "max": "max m", "rms_over_sigma": "rms / sigma"}
Cell = tuple[str, float | str | None]


def summary_page(title: str, command: str, rows: Sequence[Row], *, folders: bool) -> str:
    """The document. command: the line that makes it; folders: whether every run has one of its name."""
    keys = keys_of(rows)
    head = ["run", "state", "verdict", "effects"]
    if any(row.tried for row in rows):
        head.insert(1, "tried")
    if any(row.seed is not None for row in rows):
        head.insert(1, "seed")
    shown = [(label, key) for label in RANGES for key in ERRORS if any(_error(r, label, key) for r in rows)]
    titles = [*head, *(f"{RANGES[label]} {_UNITS[key]}" for label, key in shown), *keys, "seconds", "line"]
    body = []
    for row in rows:
        cells = [_plain(row, name, folders) for name in head]
        cells += [_number(_error(row, *where)) for where in shown]
        cells += [_parameter(row, key) for key in keys]
        cells += [_number(row.seconds), (escape(row.line), row.line or None)]
        body.append(f'<tr class="{row.state}">{"".join(_td(cell) for cell in cells)}</tr>')
    heads = "".join(
        f'<th aria-sort="none"><button type="button">{escape(text)}</button></th>' for text in titles
    )
    done, failed = (sum(row.state == state for row in rows) for state in ("done", "failed"))
    kind = "missing" if not failed else "unknown"
    words = f"{done} of {len(rows)} runs done, {failed} failed"
    files = resources.files("mphygs.batch")
    style = files.joinpath("page.css").read_text(encoding="utf-8")
    script = files.joinpath("page.js").read_text(encoding="utf-8")
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>mphygs: {escape(title)}</title>
<link rel="icon" href="data:,"><meta name="viewport" content="width=device-width, initial-scale=1">
<style>{asset("style.css")}{style}</style></head><body>
<h1>{escape(title)}</h1>
<p class="verdict {kind}">{words}</p>
<p class="quiet">A click on a head sorts by it, another one the other way. Errors are of all sequences
together, in metres; numbers stand with one standard error, those not determined in colour.</p>
<div class="wide"><table id="runs"><thead><tr>{heads}</tr></thead><tbody>
{chr(10).join(body)}
</tbody></table></div>
<h2>The command that made it</h2><pre>{escape(command)}</pre>
<script>{script}</script></body></html>
"""


def _error(row: Row, label: str, key: str) -> float | None:
    return row.errors.get(label, {}).get(key)


def _plain(row: Row, name: str, folders: bool) -> Cell:
    """A cell of words or of a count. Returns its HTML and what it is sorted by."""
    if name == "run":
        text = escape(row.name)
        link = f'<a href="{quote(row.name)}/">{text}</a>' if folders and row.state == "done" else text
        return link, row.name
    if name == "seed":
        return ("", None) if row.seed is None else (str(row.seed), float(row.seed))
    text = {
        "tried": row.tried or "",
        "state": row.state,
        "verdict": row.verdict or "",
        "effects": ", ".join(row.effects),
    }[name]
    return escape(text), text or None


def _number(value: float | None) -> Cell:
    return ("", None) if value is None else (four_digits(value), float(value))


def _parameter(row: Row, key: str) -> Cell:
    entry = row.parameters.get(key)
    if entry is None or entry["value"] is None:
        return "", None
    std = entry.get("std")
    text = four_digits(entry["value"]) + ("" if std is None else f" ± {std:.2g}")
    text = escape(f"{text} {entry.get('unit') or ''}".strip())
    return f'<span class="loose">{text}</span>' if key in row.loose else text, float(entry["value"])


def _td(cell: Cell) -> str:
    text, by = cell
    key = "" if by is None else f' data-by="{escape(str(by))}"'
    return f'<td class="number"{key}>{text}</td>' if isinstance(by, float) else f"<td{key}>{text}</td>"
