"""What a round of the loop found of every candidate, a row each, and the path of its models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mphygs.diagnose.ranking import RankedEffect, Ranking
from mphygs.extend.refit import Refit
from mphygs.extend.step import Step, excess
from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.limits import FAR
from mphygs.fit.tables import text_table
from mphygs.model.belief import Belief

Row = dict[str, object]
# Numbers that are chosen with a setting of an effect: where it is, along what.
_CHOSEN = {"place": 3, "axis": 2, "instead_of": 1}
SHOWN = 12


def candidate_rows(
    ranking: Ranking,
    refits: Sequence[Refit],
    fates: Mapping[str, str],
    before: Belief,
    kept: Step | None,
    why: str = "",
) -> tuple[Row, ...]:
    """One row a candidate as JSON, those first that were refitted, the best of them first.

    refits: brought to the end; fates: why other effects were not; before: the model that was extended; kept:
    the step that came of it, None where none did, and why.
    """
    ordered = sorted(refits, key=lambda r: excess(r.assessment))
    refitted = {r.entry.effect: r for r in ordered}
    best = kept.added[0] if kept is not None and kept.added else next(iter(refitted), "")
    entries = sorted(
        ranking.entries,
        key=lambda e: (e.effect != best, list(refitted).index(e.effect) if e.effect in refitted else np.inf),
    )
    rows = []
    for entry in entries:
        struck = _struck(entry, refitted, fates, best, kept, why)
        rows.append(_row(entry, refitted.get(entry.effect), before, struck, kept))
    return tuple(rows)


def _row(
    entry: RankedEffect, refit: Refit | None, before: Belief, struck: str | None, kept: Step | None
) -> Row:
    gain = None if refit is None else refit.gain
    ties = kept.ties if kept is not None and entry.effect in kept.added else ()
    if kept is not None and entry.effect in kept.ties:
        ties = kept.added
    estimate, std = (entry.estimate, entry.std) if refit is None else _numbers(refit)
    return {
        "effect": entry.effect,
        "way": entry.label,
        "kind": entry.kind,
        "predicted_drop": entry.statistic,
        "drop": None if refit is None else refit.actual_drop,
        "gain": None if gain is None else gain.gain,
        "gain_se": None if gain is None else gain.error,
        "numbers": _spent(entry, before),
        "estimate": {name: value for name, value in estimate.items() if np.isfinite(value)},
        "std": {name: error for name, error in std.items() if np.isfinite(error)},
        "ties": list(dict.fromkeys([*ties, *(() if refit else entry.confounded_with)])),
        "struck": struck,
    }


def with_fitted_numbers(
    rows: Sequence[Mapping[str, object]], parameters: Mapping[str, Mapping[str, object]], added: Sequence[str]
) -> list[Row]:
    """Rows in which the numbers of what was added are those that its step is told with, a standard error of
    those that are determined. parameters: of the step, by key."""
    out = []
    for row in rows:
        own = {k: e for k, e in parameters.items() if k.rsplit(".", 1)[0] == row["effect"]}
        if row["effect"] in added and own:
            names = {key.rsplit(".", 1)[1]: entry for key, entry in own.items()}
            estimate = {name: entry["value"] for name, entry in names.items()}
            std = {name: e["std"] for name, e in names.items() if e["determined"] and np.isfinite(e["std"])}
            row = {**row, "estimate": {**row["estimate"], **estimate}, "std": std}
        out.append(dict(row))
    return out


def _numbers(refit: Refit) -> tuple[dict[str, float], dict[str, float]]:
    """The effect's numbers as refitted, and their standard errors by what is left: noise, or little more."""
    belief, owner = refit.belief, f"{refit.entry.effect}."
    values = {p.key.removeprefix(owner): p.value for p in belief.parameters if p.key.startswith(owner)}
    evaluation = refit.solution.evaluation
    if evaluation.jacobian.shape[1] != len(belief.free) or evaluation.misfit > FAR:
        return values, {}
    spread = np.sqrt(np.maximum(np.diag(covariance(evaluation)), 0.0)) * max(evaluation.misfit, 1.0)
    own = zip(belief.free, spread, strict=True)
    return values, {
        p.key.removeprefix(owner): float(p.slope * s) for p, s in own if p.key.startswith(owner)
    }


def _spent(entry: RankedEffect, before: Belief) -> int:
    """How many numbers an effect takes: those that are fitted, and those that were chosen for it."""
    free = [p for p in entry.start.free if p.key not in before and p.key.startswith(f"{entry.effect}.")]
    settings = next((t.settings for t in entry.start.terms if t.name == entry.effect), {})
    return len(free) + sum(_CHOSEN.get(name, 0) for name in settings)


def _struck(
    entry: RankedEffect,
    refitted: Mapping[str, Refit],
    fates: Mapping[str, str],
    best: str,
    kept: Step | None,
    why: str,
) -> str | None:
    """Why a candidate is not in the model, None where it is, or where it ties with what is."""
    if kept is not None and entry.effect in (*kept.added, *kept.ties):
        return None
    if entry.reason:
        return entry.reason
    refit = refitted.get(entry.effect)
    if refit is None:
        return fates.get(entry.effect) or "promises too little to be refitted"
    if not (refit.pays or refit.may_pay):
        return "does not pay on unseen frames" if refit.gain is not None else "hardly lowers the error"
    if kept is None:
        return why or "leaves too much"
    left, least = refit.assessment.worst, kept.assessment.worst
    return f"leaves {left:.3f} sigma in the worst range, {best} {least:.3f}"


def path_rows(steps: Sequence[Mapping[str, object]]) -> list[Row]:
    """One row a model, from the documents of the steps: errors in sigma, of fitted and unseen frames of all
    recordings together, and by how much of the one before they fell."""
    rows: list[Row] = []
    for step in steps:
        row: Row = {
            "model": list(step["effects"]),
            "added": list(step["added"]),
            "fitted": _pooled(step, "fit"),
            "unseen": _pooled(step, "predict"),
            "grid": step.get("grid"),
            "adequate": step["adequate"],
            "p_value": step["p_value"],
        }
        for label in ("fitted", "unseen"):
            old = rows[-1][label] if rows else None
            row[f"{label}_fall"] = None if not old or row[label] is None else 1.0 - row[label] / old
        rows.append(row)
    return rows


def _pooled(step: Mapping[str, object], label: str) -> float | None:
    errors = [e for ranges in step["sequences"].values() if (e := ranges.get(label)) is not None]
    count = sum(e["count"] for e in errors)
    if not count:
        return None
    return float(np.sqrt(sum(e["count"] * e["rms_over_sigma"] ** 2 for e in errors) / count))


def table_text(rows: Sequence[Mapping[str, object]]) -> list[str]:
    """The candidates for people."""
    if not rows:
        return []
    cells = [["candidate", "predicted drop", "gain on unseen", "numbers", "estimate", "struck off, or ties"]]
    for row in rows[:SHOWN]:
        gain = "-" if row["gain"] is None else f"{row['gain']:.0f} +- {row['gain_se']:.0f}"
        fate = row["struck"] or ", ".join(f"tied with {name}" for name in row["ties"])
        cells.append(
            [row["effect"], f"{row['predicted_drop']:.0f}", gain, str(row["numbers"]), _told(row), fate or ""]
        )
    more = [f"and {len(rows) - SHOWN} more"] if len(rows) > SHOWN else []
    return ["", *text_table(cells).splitlines(), *more]


def _told(row: Mapping[str, object]) -> str:
    std = row["std"]
    return ", ".join(
        f"{name} {value:.3g}" + (f" +- {std[name]:.1g}" if name in std else "")
        for name, value in row["estimate"].items()
    )


def path_text(rows: Sequence[Mapping[str, object]]) -> list[str]:
    """The path for people."""
    cells = [["model", "fitted [sigma]", "unseen [sigma]", "fall", "grid [sigma]"]]
    for row in rows:
        fall = row["unseen_fall"] if row["unseen_fall"] is not None else row["fitted_fall"]
        cells.append(
            [
                " + ".join(row["model"]) or "elasticity alone",
                *("-" if row[k] is None else f"{row[k]:.3f}" for k in ("fitted", "unseen")),
                "" if fall is None else f"{100.0 * fall:.0f} %",
                "-" if row["grid"] is None else f"{row['grid']:.2f}",
            ]
        )
    return ["", *text_table(cells).splitlines()]
