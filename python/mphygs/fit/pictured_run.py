"""The fit of an image capture: to the tracks, then to the pictures, with parts of the method left out."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import numpy as np

from mphygs.compare.grid_share import grid_shift
from mphygs.fit.boundary_share import boundary_columns, widened
from mphygs.fit.checkpointed import fit_run
from mphygs.fit.determined import information_of
from mphygs.fit.experiment import Experiment
from mphygs.fit.grouping_prior import with_grouping
from mphygs.fit.levenberg_marquardt import Solution, covariance
from mphygs.fit.of_run import pictured_of
from mphygs.fit.run import Run, StageRecord
from mphygs.fit.stage_particles import particles_of
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# What may be left out, as in the paper's ablations.
PARTS = ("l2d", "ldt", "lg", "windows", "prestress")
PICTURES = "pictures"


class Reporter(Protocol):
    """Where a fit reports."""

    progress: Callable[[float, str], None]
    say: Callable[[str], None]


def pictured_belief(belief: Belief, stages: Path, *, without: Sequence[str], homogeneous: bool) -> Belief:
    """The belief that the fit of an image capture starts from. Raises CaptureError for bad particles."""
    if "prestress" in without:
        belief = replace(belief, prestress="off")
    if homogeneous or "lg" in without or len(belief.parts) < 2:
        return belief
    return with_grouping(belief, belief.parts, particles_of(stages, len(belief.parts)))


def fit_pictured(run: Run, experiment: Experiment, console: Reporter) -> Run:
    """The stages that a run has not had yet, those on tracks and the one on pictures.

    Raises SimulationError where the fit cannot start.
    """
    without = tuple(name.strip() for name in str(run.options.get("without") or "").split(",") if name.strip())
    given = {name: str(run.options[name]) for name in ("optimiser", "schedule")}
    run = fit_run(run, experiment, **given, windows="windows" not in without, progress=console.progress)
    if "l2d" not in without and run.history[-1].name != PICTURES:
        run = _to_pictures(run, experiment, console, distance="ldt" not in without)
    return run


def with_shares(run: Run, experiment: Experiment, say: Callable[[str], None]) -> Run:
    """A finished fit with what the grid, and boundaries that pictures leave unsure, add to its uncertainty.

    Of the grid: how far what a finer one changes in the prediction would move the numbers (`grid_shift`). Of
    boundaries: see `boundary_share`. say: told where a finer grid cannot carry the model.
    """
    spacing, names = run.settings.spacing, list(experiment.fitted)
    evaluation = experiment.problem(spacing).evaluate(run.belief)
    information = information_of(evaluation, len(run.belief.free))
    total = covariance(evaluation)
    try:
        compared = experiment.compare(run.belief, spacing, names=names, refine=True)
    except SimulationError as error:
        say(f"what a finer grid would change is not in the standard errors: {error}")
        compared = {}
    rows = evaluation.jacobian[evaluation.data_rows :]
    shift = grid_shift(compared, rows.T @ rows) if compared else None
    columns = boundary_columns(experiment.capture.parts, run.belief.free)
    total, information = widened(total, information, columns)
    if shift is not None:
        total = total + np.outer(shift, shift)
    return replace(run, covariance=total, information=information)


def _to_pictures(run: Run, experiment: Experiment, console: Reporter, *, distance: bool) -> Run:
    # torch takes seconds to import
    from mphygs.fit.image_fit import fit_to_pictures, fit_to_pictures_by_adam
    from mphygs.render.video_loss import VideoWeights

    began = time.monotonic()
    problem = experiment.problem(run.settings.spacing)
    evaluation = problem.evaluate(run.belief)
    solution = Solution(run.belief, evaluation, (evaluation.cost,), True, "kept")
    weights = VideoWeights() if distance else VideoWeights(distance=0.0)
    pictured = pictured_of(run, experiment)
    if run.options["schedule"] == "paper":
        found = fit_to_pictures_by_adam(pictured, run.belief, weights=weights, report=console.say)
    else:
        found = fit_to_pictures(pictured, solution, weights=weights, report=console.say)
    kept = len(found.history) > 1
    reason = "lowers L_2D" if kept else "nothing lowers L_2D on frames that were left out as well"
    record = StageRecord(
        PICTURES, run.settings.spacing, found.history, kept, reason, time.monotonic() - began
    )
    return run.after(record, found.belief)
