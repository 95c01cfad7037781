"""Baselines by name: each a module with `fit`, and with `maker` where the simulator does not predict."""

from __future__ import annotations

from importlib import import_module
from typing import Literal, get_args

from mphygs.baselines.training import Progress
from mphygs.fit.experiment import Experiment
from mphygs.fit.of_run import baseline_of
from mphygs.fit.run import Run
from mphygs.simulate.prediction import Maker, Predictor

# What others do, each in a module of its own.
Baseline = Literal["homogeneous", "springs", "neural", "graph", "field", "laws", "prior"]
NAMES: tuple[Baseline, ...] = get_args(Baseline)


def fit_baseline(run: Run, experiment: Experiment, progress: Progress, **extra: object) -> Run:
    """The complete run of the baseline of its options. extra: what one takes besides, the examples of
    `prior`.

    Raises SimulationError where it cannot start.
    """
    return _module(baseline_of(run)).fit(run, experiment, progress, **extra)


def maker_of(run: Run) -> Maker:
    """What makes the predictors of a run, the simulator's where it is no baseline or one that simulates.

    Raises ValueError where a baseline is not finished or its numbers are damaged.
    """
    name = baseline_of(run)
    if name is None:
        return Predictor
    make = getattr(_module(name), "maker", None)
    return Predictor if make is None else make(run)


def _module(name: str | None) -> object:
    if name not in NAMES:
        raise ValueError(f"baseline '{name}': expected one of {', '.join(NAMES)}")
    return import_module(f"mphygs.baselines.{name}")
