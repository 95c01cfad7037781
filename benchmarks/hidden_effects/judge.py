"""What a discovery got right and wrong about one capture, as a record of plain numbers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from cases import Case

from mphygs.model.registry import effects

# Of a run, what its first diagnosis ranked: absent where there was none.
DIAGNOSIS = "diagnosis.json"


def record(case: Case, capture: Path, run: Path, told: Mapping[str, object]) -> dict[str, object]:
    """Verdict, names, the true effect's statistic, errors of parameters, held-out error.

    capture: with its answer.json; run: of the loop, with its diagnosis; told: the loop's own JSON.
    """
    answer = json.loads((capture / "answer.json").read_text())
    steps, diagnosis = told["steps"], run / DIAGNOSIS
    ranking = json.loads(diagnosis.read_text())["ranking"] if diagnosis.is_file() else []
    return {
        "true": list(case.true_names),
        "allowed": list(case.group_of),
        "signal_over_noise": answer["signal_over_noise"],
        "verdict": told["verdict"],
        "effects": list(told["effects"]),
        "added": [step["added"] for step in steps[1:]],
        "ties": sorted({name for step in steps for name in step["ties"]}),
        "statistic": max((e["statistic"] for e in ranking if e["effect"] in case.true_names), default=None),
        "ranking": [
            {key: e[key] for key in ("effect", "statistic", "p_value", "confounded_with")}
            for e in ranking[:5]
        ],
        "errors_in_std": _parameter_errors(case, answer, steps[-1]["parameters"]),
        "error_before": _ratios(steps[0], "fit") + _ratios(steps[0], "predict"),
        "held_out": _ratios(steps[-1], "predict"),
        "predicted_over_actual": _drops(steps),
        "warnings": list(told["warnings"]),
    }


def _ratios(step: Mapping[str, object], label: str) -> list[float]:
    """Residual over noise on the ranges called `label`, sequence by sequence."""
    found = (ranges.get(label) for ranges in step["sequences"].values())
    return [float(error["rms_over_sigma"]) for error in found if error is not None]


def _parameter_errors(
    case: Case, answer: Mapping[str, object], told: Mapping[str, Mapping[str, object]]
) -> dict[str, float]:
    """(found - true) / standard error of every strength and place of a true effect that is in the last
    model. told: its numbers."""
    truth: dict[str, float] = {}
    for name in case.true_names:
        values = {**answer["effects"], **answer["faults"]}.get(name, {})
        truth |= {f"{name}.{key}": value for key, value in values.items() if isinstance(value, float)}
        place = values.get("place") or ()
        truth |= {f"{name}.place_{axis}": at for axis, at in zip("xyz", place, strict=False)}
    return {
        key: (told[key]["value"] - value) / told[key]["std"]
        for key, value in truth.items()
        if key in told and (told[key]["std"] or 0.0) > 0.0
    }


def _drops(steps: Sequence[Mapping[str, object]]) -> list[float]:
    """Predicted over actual drop of chi^2 of every effect that was added."""
    return [
        row["predicted_drop"] / row["drop"]
        for step in steps
        for row in step["table"]
        if row["effect"] in step["added"] and (row["drop"] or 0.0) > 0.0
    ]


def is_physics(name: str) -> bool:
    """Whether a name of the registry is no fault of measurement."""
    return effects()[name].kind != "measurement"
