"""What a discovery got right and wrong about one capture, as a record of plain numbers."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from cases import Case

from mphygs.extend.conclusion import Discovery
from mphygs.extend.step_uncertainty import uncertainty
from mphygs.fit.experiment import Experiment
from mphygs.fit.place_fit import place_of
from mphygs.model.registry import effects


def record(
    case: Case, answer: Mapping[str, object], found: Discovery, experiment: Experiment, seconds: float
) -> dict[str, object]:
    """Verdict, names, the true effect's statistic, errors of parameters, held-out error."""
    first, last = found.steps[0], found.steps[-1]
    ties = sorted({name for step in found.steps for name in step.ties})
    return {
        "case": case.name,
        "group": case.group,
        "true": list(case.true_names),
        "allowed": list(case.group_of),
        "signal_over_noise": answer["signal_over_noise"],
        "verdict": found.verdict,
        "effects": list(found.effects),
        "added": [list(step.added) for step in found.steps[1:]],
        "ties": ties,
        "statistic": _statistic(case, found),
        "ranking": [
            {
                "effect": e.effect,
                "statistic": e.statistic,
                "p_value": e.p_value,
                "confounded_with": list(e.confounded_with),
            }
            for e in (found.rankings[0].entries[:5] if found.rankings else ())
        ],
        "errors_in_std": _parameter_errors(case, answer, found, experiment),
        "error_before": _ratios(first, "fit") + _ratios(first, "predict"),
        "held_out": _ratios(last, "predict"),
        "predicted_over_actual": _drops(found),
        "seconds": seconds,
        "warnings": list(found.warnings),
    }


def _statistic(case: Case, found: Discovery) -> float | None:
    """Statistic of the strongest true name in the first ranking."""
    if not found.rankings:
        return None
    values = [e.statistic for e in found.rankings[0].entries if e.effect in case.true_names]
    return max(values, default=None)


def _ratios(step: object, label: str) -> list[float]:
    """Residual over noise on the ranges called `label`, sequence by sequence."""
    return [float(ranges[label]) for ranges in step.assessment.ratio.values() if label in ranges]


def _parameter_errors(
    case: Case, answer: Mapping[str, object], found: Discovery, experiment: Experiment
) -> dict[str, float]:
    """(found - true) / standard error of every strength of a true effect that is in the last model."""
    step = found.steps[-1]
    spread = uncertainty(step, experiment)
    deviations = np.sqrt(np.diag(spread.covariance))
    truth: dict[str, float] = {}
    for name in case.true_names:
        values = {**answer["effects"], **answer["faults"]}.get(name, {})
        truth |= {f"{name}.{key}": value for key, value in values.items() if isinstance(value, float)}
    errors = {}
    for name, std in spread.places.items():
        place = answer["effects"].get(name, {}).get("place")
        if place is not None:
            off = (place_of(step.belief, name) - place) / std
            errors |= {f"{name}.place_{axis}": float(e) for axis, e in zip("xyz", off, strict=True)}
    for parameter, deviation in zip(step.belief.free, deviations, strict=True):
        if parameter.key in truth and deviation > 0.0:
            errors[parameter.key] = float(
                (parameter.value - truth[parameter.key]) / (deviation * parameter.slope)
            )
    return errors


def _drops(found: Discovery) -> list[float]:
    """Predicted over actual drop of chi^2 of every effect that was added."""
    ratios = []
    for step in found.steps[1:]:
        for trial in step.refits:
            if trial.entry.effect in step.added and trial.actual_drop > 0.0:
                ratios.append(float(trial.entry.statistic / trial.actual_drop))
    return ratios


def is_physics(name: str) -> bool:
    """Whether a name of the registry is no fault of measurement."""
    return effects()[name].kind != "measurement"
