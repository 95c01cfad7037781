"""One row a run: what it concluded, the numbers that it found, and the errors that it left."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from mphygs.batch.work import Outcome, Task
from mphygs.fit.tables import text_table

RANGES = {"fit": "fitted", "predict": "unseen"}
ERRORS = ("rms", "max", "rms_over_sigma")
Errors = dict[str, dict[str, float | None]]


@dataclass(frozen=True)
class Row:
    """What came of one run.

    errors: by range of frames, of all sequences together, rms and max in [m]; parameters: by key: value,
    std, unit and whether it is determined, what of that is known; line: that it failed with.
    """

    name: str
    folder: str
    state: str
    seed: int | None = None
    tried: str | None = None
    verdict: str | None = None
    effects: tuple[str, ...] = ()
    errors: Errors = field(default_factory=dict)
    parameters: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    seconds: float | None = None
    line: str = ""

    @property
    def loose(self) -> list[str]:
        """Numbers that the data do not determine."""
        return [key for key, entry in self.parameters.items() if entry.get("determined") is False]

    def document(self) -> dict[str, object]:
        """The row as JSON knows it."""
        return {
            "name": self.name,
            "folder": self.folder,
            "state": self.state,
            "seed": self.seed,
            "tried": self.tried,
            "verdict": self.verdict,
            "effects": list(self.effects),
            "errors": self.errors,
            "parameters": {key: dict(entry) for key, entry in self.parameters.items()},
            "seconds": self.seconds,
            "line": self.line,
        }


def row_of(task: Task, outcome: Outcome | None) -> Row:
    """The row of a run; outcome: None where it has not ended."""
    known = {"name": task.name, "folder": task.folder, "seed": task.seed, "tried": task.effects}
    if outcome is None:
        return Row(**known, state="waiting")
    if not outcome.done:
        return Row(**known, state="failed", seconds=outcome.seconds, line=outcome.line)
    answer = outcome.answer
    last = answer["steps"][-1] if answer.get("steps") else answer
    numbers = {k: entry for k, entry in (last.get("parameters") or {}).items() if "value" in entry}
    return Row(
        **known,
        state="done",
        verdict=_verdict(answer),
        effects=tuple(answer.get("effects") or ()),
        errors=_pooled(last.get("sequences") or {}) or _diagnosis_errors(answer),
        parameters=numbers or _diagnosis_parameters(answer),
        seconds=outcome.seconds,
    )


def _verdict(answer: Mapping) -> str | None:
    if "verdict" in answer:
        return answer["verdict"]
    return {True: "adequate", False: "more than noise"}.get(answer.get("adequate"))


def _pooled(sequences: Mapping) -> Errors:
    """Errors of all sequences together: of all points, the root mean square and the largest."""
    found: Errors = {}
    if not isinstance(sequences, Mapping):
        return found
    for label in RANGES:
        errors = [e for r in sequences.values() if (e := r.get(label)) and e.get("rms") is not None]
        count = sum(e["count"] for e in errors)
        if count:
            found[label] = {
                "rms": _rms(errors, "rms", count),
                "max": max(e["max"] for e in errors),
                "rms_over_sigma": _rms(errors, "rms_over_sigma", count),
            }
    return found


def _rms(errors: Sequence[Mapping], key: str, count: int) -> float | None:
    if any(e.get(key) is None for e in errors):
        return None
    return math.sqrt(sum(e["count"] * e[key] ** 2 for e in errors) / count)


def _diagnosis_errors(answer: Mapping) -> Errors:
    """Errors of a diagnosis, whose first row of `path` is the run that it was made of."""
    first = next(iter(answer.get("path") or ()), {})
    return {
        label: {"rms": None, "max": None, "rms_over_sigma": first[key]}
        for label, key in RANGES.items()
        if first.get(key) is not None
    }


def _diagnosis_parameters(answer: Mapping) -> dict[str, dict[str, object]]:
    """The numbers of the effects that a diagnosis would add."""
    return {
        f"{row['effect']}.{key}": {"value": value, "std": (row.get("std") or {}).get(key)}
        for row in answer.get("table") or ()
        if row.get("effect") in (answer.get("effects") or ())
        for key, value in (row.get("estimate") or {}).items()
        if isinstance(value, float)
    }


def keys_of(rows: Sequence[Row]) -> list[str]:
    """All numbers that any of the runs found, in the order in which they come up."""
    return list(dict.fromkeys(key for row in rows for key in row.parameters))


def csv_text(rows: Sequence[Row]) -> str:
    """The table as CSV, numbers to their last digit; what a run has not is empty."""
    keys = keys_of(rows)
    head = ["run", "folder", "seed", "tried", "state", "verdict", "effects"]
    head += [f"{label}_{key}{'_m' if key in ('rms', 'max') else ''}" for label in RANGES for key in ERRORS]
    units = {key: entry.get("unit") for row in rows for key, entry in row.parameters.items()}
    for key in keys:
        unit = f" [{units[key]}]" if units[key] else ""
        head += [f"{key}{unit}", f"{key} std{unit}"]
    head += ["not determined", "seconds", "line"]
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        cells = [row.name, row.folder, row.seed, row.tried, row.state, row.verdict, " ".join(row.effects)]
        cells += [row.errors.get(label, {}).get(key) for label in RANGES for key in ERRORS]
        for key in keys:
            entry = row.parameters.get(key, {})
            cells += [entry.get("value"), entry.get("std")]
        writer.writerow([*cells, " ".join(row.loose), row.seconds, row.line])
    return stream.getvalue()


def text_of(rows: Sequence[Row], out: Path) -> str:
    """The table for people, and what failed."""
    head = ["run", "verdict", "effects", "fitted mm", "unseen mm", "fitted / sigma", "unseen / sigma"]
    cells = [head]
    for row in rows:
        if row.state != "done":
            continue
        errors = [(row.errors.get(label, {}).get("rms"), 1e3) for label in RANGES]
        errors += [(row.errors.get(label, {}).get("rms_over_sigma"), 1.0) for label in RANGES]
        shown = ["-" if value is None else f"{scale * value:.3f}" for value, scale in errors]
        cells.append([row.name, row.verdict or "-", ", ".join(row.effects) or "-", *shown])
    lines = [text_table(cells), ""] if len(cells) > 1 else []
    failed = [row for row in rows if row.state == "failed"]
    lines.append(f"{len(cells) - 1} of {len(rows)} runs done, {len(failed)} failed")
    lines += [f"  {row.name}: {row.line}" for row in failed]
    return "\n".join([*lines, "", f"all numbers: {out / 'summary.csv'}, {out / 'summary.html'}"])
