"""Fitted numbers and errors as text for people and as JSON."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mphygs.fit.determined import determinations, of_unit_length
from mphygs.fit.limits import FAR, Limits, with_bounds
from mphygs.fit.place_uncertainty import places_document
from mphygs.fit.profile import Interval
from mphygs.fit.run import Run
from mphygs.model.belief import Belief


def parameters_of(run: Run, found: Mapping[str, Interval] | None = None) -> dict[str, dict[str, object]]:
    """Fitted parameters of a run. found: intervals from the likelihood by key, where they were asked for.

    Raises ValueError for a run that is not complete.
    """
    if run.covariance is None or run.information is None:
        raise ValueError(
            f"{run.folder}: is not complete; expected a finished run (fit --out {run.folder} --resume)"
        )
    misfit = run.history[-1].misfit if run.history else 0.0
    document = parameter_lines(run.belief, run.information, run.covariance, misfit, run.limits)
    for key, interval in (found or {}).items():
        document[key]["interval"] = [interval.lower, interval.upper]
    return document


def parameter_lines(
    belief: Belief,
    information: np.ndarray,
    covariance: np.ndarray,
    misfit: float,
    limits: Mapping[str, Limits],
) -> dict[str, dict[str, object]]:
    """What every command tells of fitted numbers: `parameters_document`, where the model leaves little more
    than noise, with bounds of what shows on one side alone.

    misfit: of the fitted frames [sigma]; limits: of numbers that were asked for, which the matrices know.
    """
    document = parameters_document(belief, information, covariance)
    if misfit > FAR:
        for entry in document.values():
            if entry.get("determined"):
                why = f"the model leaves {misfit:.3g} times the noise, and what it lacks bends this"
                entry |= {"determined": False, "note": why}
        return document
    return with_bounds(document, limits)


def parameters_document(
    belief: Belief, information: np.ndarray, covariance: np.ndarray
) -> dict[str, dict[str, object]]:
    """Key -> value, std, unit, whether the data determine it, and a note where there is something to say.

    Directions are told as unit vectors, and how sure they are across; places that were fitted by axis.

    information: (P, P) of the measurements, covariance: (P, P), of the free coordinates.
    """
    free, information, covariance = of_unit_length(belief.free, information, covariance)
    known = determinations(free, information, covariance)
    out = {}
    for parameter in free:
        found = known[parameter.key]
        entry = {
            "value": parameter.value,
            "std": found.std,
            "unit": parameter.unit,
            "determined": found.determined,
        }
        out[parameter.key] = entry | ({"note": found.note} if found.note else {})
    return out | places_document(belief)


def text_table(rows: Sequence[Sequence[str]]) -> str:
    """Rows of cells in aligned columns; the first row is the head."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join([lines[0], "-" * max(len(line) for line in lines), *lines[1:]])


def parameters_text(parameters: Mapping[str, Mapping[str, object]]) -> str:
    """The fitted parameters, one a line; what the data do not determine says so."""
    spans = any("interval" in entry for entry in parameters.values())
    rows = [["parameter", "value", "std", "unit", *(["interval (2 sd)"] if spans else []), ""]]
    for key, entry in parameters.items():
        remark = str(entry.get("note", ""))
        if not entry["determined"]:
            remark = f"NOT DETERMINED: {remark}"
        span = [" to ".join(f"{end:.4g}" for end in entry.get("interval", ()))] if spans else []
        rows.append([key, f"{entry['value']:.5g}", f"{entry['std']:.2g}", str(entry["unit"]), *span, remark])
    return text_table(rows)


def number_text(entry: Mapping[str, object]) -> str:
    """One fitted number in a line."""
    if entry["determined"]:
        std = "?" if entry["std"] is None else f"{entry['std']:.2g}"
        return f"{entry['value']:.4g} +- {std} {entry['unit']}"
    return f"{entry['value']:.4g} {entry['unit']}, NOT DETERMINED: {entry.get('note', '')}"


def feedback_lines(feedback: Mapping[str, object]) -> list[str]:
    """The errors of a model under feedback, as text."""
    gain, sequences = feedback["gain"], feedback["sequences"]
    return [f"under feedback from the measurement, gain {gain:g}:", errors_text(sequences), ""]


def errors_text(sequences: Mapping[str, Mapping[str, Mapping[str, float] | None]]) -> str:
    """Errors by sequence and range of frames, in millimetres and in standard deviations of the noise."""
    rows = [["sequence", "frames", "rms mm", "max mm", "rms / sigma", "points"]]
    for name, ranges in sequences.items():
        for label in ("fit", "predict", "all"):
            error = ranges.get(label)
            if error is not None and error["rms"] is not None:
                rows.append(
                    [
                        name,
                        label,
                        f"{1e3 * error['rms']:.3f}",
                        f"{1e3 * error['max']:.3f}",
                        f"{error['rms_over_sigma']:.3f}",
                        str(error["count"]),
                    ]
                )
    return text_table(rows)
