"""The benchmark's table and its summary, from the records of all cases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from judge import is_physics

# Above this statistic an effect is large enough that it should be named first.
LARGE = 64.0
HELD_OUT = 1.1
STANDARD_ERRORS = 2.0
_COLUMNS = (
    ("case", 24),
    ("seed", 4),
    ("S/N", 6),
    ("stat", 8),
    ("verdict", 12),
    ("effects", 34),
    ("ties", 26),
    ("ok", 3),
    ("err/std", 8),
    ("held out", 8),
    ("pred/act", 8),
    ("s", 6),
)


def right(entry: dict) -> bool:
    """Whether the conclusion is the one that the case wants."""
    if entry.get("error"):
        return False
    concluded, true = entry["effects"], set(entry["true"])
    match entry["group"]:
        case "null":
            return entry["verdict"] == "adequate" and not concluded
        case "outside":
            return entry["verdict"] == "unknown"
        case "fault":
            return entry["verdict"] == "measurement" and set(concluded) == true
        case "pair":
            return set(concluded) == true
        case "trap":
            return named_first(entry) and tied(entry)
        case _:
            return named_first(entry) or in_ties(entry)


def named_first(entry: dict) -> bool:
    """Whether the first name concluded is hidden, or one that acts so much alike that it may stand for it."""
    return bool(entry["effects"]) and entry["effects"][0] in (*entry["true"], *entry["allowed"])


def in_ties(entry: dict) -> bool:
    """Whether what is hidden is among those reported as not told apart from the first."""
    return bool(entry["effects"]) and bool(set(entry["true"]) & set(entry["ties"]))


def tied(entry: dict) -> bool:
    """Whether what acts alike, or what is hidden, is reported as not told apart from what was named."""
    return bool(set(entry["ties"]) & {*entry["true"], *entry["allowed"]})


def _worst(values: Sequence[float]) -> str:
    return f"{max(values, key=abs):.2f}" if values else "-"


def rows(records: Sequence[dict]) -> list[str]:
    """One line a record, under a line of names."""
    lines = ["  ".join(f"{name:<{width}}" for name, width in _COLUMNS).rstrip()]
    for entry in records:
        if entry.get("error"):
            cells = [entry["case"], str(entry["seed"]), "", "", "error", entry["error"][:80]]
        else:
            signal, statistic = entry["signal_over_noise"], entry["statistic"]
            cells = [
                entry["case"],
                str(entry["seed"]),
                "-" if signal is None else f"{signal:.1f}",
                "-" if statistic is None else f"{statistic:.0f}",
                entry["verdict"],
                ",".join(entry["effects"]) or "-",
                ",".join(entry["ties"]) or "-",
                "yes" if right(entry) else "NO",
                _worst(list(entry["errors_in_std"].values())),
                _worst(entry["held_out"]),
                _worst(entry["predicted_over_actual"]),
                f"{entry['seconds']:.0f}",
            ]
        lines.append("  ".join(f"{c:<{w}}" for c, (_, w) in zip(cells, _COLUMNS, strict=False)).rstrip())
    return lines


def _rate(hits: Sequence[bool]) -> dict[str, object]:
    return {"of": len(hits), "count": int(sum(hits)), "rate": float(np.mean(hits)) if hits else None}


def summary(records: Sequence[dict]) -> dict[str, object]:
    """The numbers that say how good the loop is; what each asks for stands beside it in the README."""
    done = [r for r in records if not r.get("error")]

    def group(*names: str) -> list[dict]:
        return [r for r in done if r["group"] in names]

    physics = group("single", "pair")
    large = [r for r in physics if (r["statistic"] or 0.0) > LARGE]
    small = [r for r in physics if r not in large]
    errors = [abs(e) for r in physics for e in r["errors_in_std"].values()]
    explained = [r for r in group("single", "pair", "near", "trap") if r["verdict"] == "missing"]
    held_out = [max(r["held_out"]) for r in explained if r["held_out"]]
    ratios = [x for r in done for x in r["predicted_over_actual"]]
    seconds = [r["seconds"] for r in done]
    return {
        "named_first": _rate([named_first(r) for r in large]),
        "named_first_small": _rate([named_first(r) for r in small]),
        "named_or_in_ties": _rate([named_first(r) or in_ties(r) for r in physics]),
        "pairs_complete": _rate([right(r) for r in group("pair")]),
        "near_pairs_named": _rate([right(r) for r in group("near")]),
        "traps_with_ties": _rate([right(r) for r in group("trap")]),
        "false_alarms": _rate([bool(r["effects"]) for r in group("null")]),
        "nulls_not_adequate": _rate([r["verdict"] != "adequate" for r in group("null")]),
        "unknown": _rate([r["verdict"] == "unknown" for r in group("outside")]),
        "faults_found": _rate([right(r) for r in group("fault")]),
        "faults_blamed_on_physics": _rate([any(is_physics(n) for n in r["effects"]) for r in group("fault")]),
        "parameters_within_2_std": _rate([e <= STANDARD_ERRORS for e in errors]),
        "median_error_in_std": float(np.median(errors)) if errors else None,
        "held_out_at_most_1.1": _rate([x <= HELD_OUT for x in held_out]),
        "median_held_out": float(np.median(held_out)) if held_out else None,
        "median_predicted_over_actual": float(np.median(ratios)) if ratios else None,
        "predicted_within_factor_2": _rate([0.5 <= x <= 2.0 for x in ratios]),
        "median_seconds": float(np.median(seconds)) if seconds else None,
        "errors": len(records) - len(done),
    }


def summary_text(numbers: dict[str, object]) -> list[str]:
    """The summary for people."""
    lines = []
    for name, value in numbers.items():
        label = name.replace("_", " ")
        if isinstance(value, dict):
            share = "-" if value["rate"] is None else f"{100.0 * value['rate']:.0f} %"
            lines.append(f"{label:<30}{share:>7}  ({value['count']} of {value['of']})")
        else:
            lines.append(f"{label:<30}{'-' if value is None else format(value, '.3g'):>7}")
    return lines
