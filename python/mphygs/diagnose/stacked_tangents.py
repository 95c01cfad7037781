"""Whitened tangents of candidate effects over the fitted frames, and which of them can be simulated."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mphygs.diagnose.decoys import decoy_tangents
from mphygs.diagnose.effect_variants import EffectVariant
from mphygs.diagnose.ranking import RankedEffect, unsimulated
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# Effects that do nothing, scored beside the candidates.
DECOYS = 20


def stacked_tangents(
    experiment: Experiment,
    problem: Problem,
    belief: Belief,
    variants: Sequence[EffectVariant],
    report: Callable[[str], None] | None,
    generator: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Whitened Jacobian columns of all variants over the fitted frames, (N, Q), in their order, and of
    decoys that are as smooth, (N, DECOYS)."""
    columns = [pair for variant in variants for pair in variant.columns]
    blocks, decoys, sensors = [], [], []
    for name, (first, last) in problem.ranges.items():
        if report:
            report(f"tangents of {len(columns)} candidate parameters on {name}")
        prediction = problem.predictors[name].predict(belief, last=last, candidates=columns)
        whitener = experiment.observations[name].whitener(first, last)
        # Coordinates are values over scales: back to units of the parameter.
        slopes = np.array([p.slope for _, p in columns])
        raw = prediction.jacobian[first:last]
        blocks.append(whitener.whiten(raw) / slopes)
        if np.any(raw):
            decoys.append(whitener.whiten(decoy_tangents(raw, DECOYS, generator=generator)))
        else:
            decoys.append(np.zeros((len(blocks[-1]), DECOYS)))
        for sensor, reading in zip(experiment.observations[name].sensors, prediction.readings, strict=True):
            sensors.append(sensor.whitener(first, last).whiten(reading.jacobian[first:last]) / slopes)
    # Decoys move markers alone.
    decoys += [np.zeros((len(block), DECOYS)) for block in sensors]
    return np.concatenate([*blocks, *sensors]), np.concatenate(decoys)


def simulable_variants(
    experiment: Experiment,
    problem: Problem,
    belief: Belief,
    variants: Sequence[EffectVariant],
    misfit: float,
    report: Callable[[str], None] | None,
) -> tuple[list[EffectVariant], list[RankedEffect]]:
    """The variants of those effects that can be simulated beside the model at their null, and the others,
    each with the reason. misfit: of the model [sigma]. Raises SimulationError where there is none."""
    failed: dict[str, SimulationError] = {}
    for name in dict.fromkeys(variant.effect for variant in variants):
        own = [variant for variant in variants if variant.effect == name]
        try:
            stacked_tangents(experiment, problem, belief, own, None, np.random.default_rng(0))
        except SimulationError as error:
            failed[name] = error
            if report:
                report(f"{name} is left out, for it cannot be simulated: {error}")
    left = [variant for variant in variants if variant.effect not in failed]
    if not left and failed:
        raise next(iter(failed.values()))
    struck = [unsimulated(name, name, str(error), belief, misfit) for name, error in failed.items()]
    return left, struck
