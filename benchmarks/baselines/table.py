"""The table of baselines, for people."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

HEAD = (
    "hidden", "seed", "model", "fitted frames", "unseen frames", "unseen motion", "seconds",
    "of the processor", "names",
)  # fmt: skip


def markdown(records: Sequence[Mapping[str, object]]) -> str:
    """One row a model and capture: root mean square errors over the noise, 1 for noise alone, and in mm."""
    lines = [_row(*HEAD), _row(*["---"] * len(HEAD))]
    for entry in records:
        who = (str(entry["case"]), str(entry["seed"]), str(entry["row"]))
        if "error" in entry:
            lines.append(_row(*who, str(entry["error"]), *[""] * 5))
            continue
        cells = [_error(entry["errors"][where]) for where in ("fitted", "frames", "motion")]
        named = entry["effects"]
        names = "" if named is None else ", ".join(named) or "nothing"
        # what went on after a break does not know what it had taken
        processor = f"{entry['processor']:.0f}" if "processor" in entry else "-"
        lines.append(_row(*who, *cells, f"{entry['seconds']:.0f}", processor, names))
    return "\n".join(lines)


def _error(error: Mapping[str, float]) -> str:
    return f"{error['rms_over_sigma']:.2f} ({1e3 * error['rms']:.2f} mm)"


def _row(*cells: str) -> str:
    return "| " + " | ".join(cells) + " |"
