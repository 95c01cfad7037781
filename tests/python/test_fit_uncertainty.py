"""How sure a fit says that its numbers are: the noise, what a model leaves, and the grid."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from command_example import answer
from extend_example import SIGMA, recorded
from mphygs.capture.record import Known
from mphygs.capture.save import save_capture
from mphygs.commands import fit
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import covariance, minimise
from mphygs.fit.of_run import experiment_of
from mphygs.fit.run import load_run
from mphygs.fit.spacings import screening_spacing
from mphygs.fit.uncertainty import coordinate_covariance, grid_change, grid_moves, prediction_change
from mphygs.simulate.settings import Settings

FREE, FRAMES = ("part0.youngs_modulus",), 24


def test_what_a_model_leaves_counts_as_noise() -> None:
    shake = 0.006 * np.sin(np.linspace(0.0, 9.0, FRAMES))[:, None] * [0.2, 1.0, 0.4]
    capture = bar_capture(frames=FRAMES, fps=60.0, motion=shake, fit=(0, FRAMES), sigma=SIGMA)
    belief = bar_belief(capture, youngs_modulus=5e4, free=FREE)
    for truth, misfit in ((belief, 1.0), (belief.with_effect("mass_damping", {"alpha": 8.0}), 5.0)):
        made = recorded(capture, truth)
        problem = Experiment.of(made, Settings(0.01, workers=1)).problem(0.01)
        found = minimise(problem, belief).evaluation
        left = max(found.misfit, 1.0)
        assert left == pytest.approx(1.0, abs=0.1) if misfit == 1.0 else left > misfit
        spread = coordinate_covariance(problem, found)
        if misfit == 1.0:
            np.testing.assert_allclose(spread, covariance(found) * left**2)
        else:  # what lasts besides
            assert spread[0, 0] > 1.5 * covariance(found)[0, 0] * left**2


def test_a_grid_counts_by_how_far_a_finer_one_would_still_move_a_number() -> None:
    capture = bar_capture(lengths=(0.03, 0.03))
    free = ("part0.youngs_modulus", "part1.youngs_modulus")
    fine = bar_belief(capture, youngs_modulus=1e5, free=free)
    coarse = fine.with_parameter(free[0], value=1.3e5)
    # An error of c h in ln E: from a grid twice as coarse, as much as the change is left.
    change = grid_change(coarse, fine, 2.0)
    np.testing.assert_allclose(change, [-np.log(1.3), 0.0])
    at_bound = coarse.with_parameter(free[0], value=coarse[free[0]].upper)
    np.testing.assert_allclose(grid_change(at_bound, fine, 2.0), 0.0)
    with pytest.raises(ValueError, match="ratio of spacings 1; expected another than 1"):
        grid_change(coarse, fine, 1.0)


def test_a_number_that_the_model_bends_is_told_as_not_determined(tmp_path: Path) -> None:
    shake = 0.006 * np.sin(np.linspace(0.0, 9.0, FRAMES))[:, None] * [0.2, 1.0, 0.4]
    known = Known(density={"part0": 1000.0})
    capture = bar_capture(
        frames=FRAMES, fps=60.0, motion=shake, fit=(0, FRAMES), sigma=SIGMA, known=known
    )
    truth = bar_belief(capture, youngs_modulus=5e4)
    for name, belief in (("right", truth), ("wrong", truth.with_effect("mass_damping", {"alpha": 8.0}))):
        folder = tmp_path / name
        save_capture(replace(recorded(capture, belief), name=name), folder)
        found = answer(fit.main, folder, "--out", tmp_path / f"{name}-run", "--spacing", "0.01")
        told = found["parameters"]["part0.youngs_modulus"]
        assert told["determined"] is (name == "right")
        assert ("times the noise" in told.get("note", "")) is (name == "wrong")


def test_a_fit_counts_how_far_its_grids_are_apart(tmp_path: Path) -> None:
    shake = 0.006 * np.sin(np.linspace(0.0, 9.0, FRAMES))[:, None] * [0.2, 1.0, 0.4]
    known = Known(density={"part0": 1000.0})
    capture = bar_capture(
        frames=FRAMES, fps=60.0, motion=shake, fit=(0, FRAMES), sigma=SIGMA, known=known
    )
    save_capture(recorded(capture, bar_belief(capture, youngs_modulus=5e4)), tmp_path / "bar")
    told = answer(fit.main, tmp_path / "bar", "--out", tmp_path / "run", "--spacing", "0.006")
    run = load_run(tmp_path / "run")
    coarse, fine = run.history[-2:]
    assert coarse.spacing > fine.spacing and run.earlier is not None
    change = grid_change(run.earlier, run.belief, coarse.spacing / fine.spacing)
    experiment, belief = experiment_of(run)
    problem, ratio = experiment.problem(fine.spacing), coarse.spacing / fine.spacing
    found = problem.evaluate(belief)
    noise = coordinate_covariance(problem, found)
    rows = prediction_change(found, experiment.problem(coarse.spacing).evaluate(belief), ratio)
    moved = grid_moves(problem, found, rows, covariance(found))
    # One of the directions is the change itself: what a fit would make of it, less than of all that drifts.
    straight = covariance(found) @ (found.jacobian[: len(rows)].T @ rows)
    assert (moved @ moved.T)[0, 0] > straight[0] ** 2 / 6.0
    np.testing.assert_allclose(
        run.covariance, noise + np.outer(change, change) + moved @ moved.T, rtol=1e-3
    )
    (parameter,) = belief.free
    std = told["parameters"]["part0.youngs_modulus"]["std"]
    assert std >= 0.99 * abs(change[0]) * parameter.slope > 0.1 * std


@pytest.mark.parametrize("below", [1.0, 1.02, 1.25])
def test_a_fit_on_one_coarse_grid_asks_a_finer_one_for_its_error(below: float, tmp_path: Path) -> None:
    """Where the coarsest grid is no coarser, or hardly.

    Recorded on a finer grid, E is off by many deviations of the noise, and by few of those told."""
    shake = 0.006 * np.sin(np.linspace(0.0, 9.0, FRAMES))[:, None] * [0.2, 1.0, 0.4]
    known = Known(density={"part0": 1000.0}, poissons_ratio=0.3)
    capture = bar_capture(
        frames=FRAMES, fps=60.0, motion=shake, fit=(0, FRAMES), sigma=SIGMA, known=known
    )
    spacing = round(screening_spacing(capture) / below, 6)
    save_capture(recorded(capture, bar_belief(capture, youngs_modulus=5e4), 0.004), tmp_path / "bar")
    told = answer(fit.main, tmp_path / "bar", "--out", tmp_path / "run", "--spacing", str(spacing))
    run = load_run(tmp_path / "run")
    assert {stage.spacing for stage in run.history} == {spacing}
    experiment, belief = experiment_of(run)
    noise = float(np.sqrt(covariance(experiment.problem(spacing).evaluate(belief))[0, 0])) * 5e4
    entry = told["parameters"]["part0.youngs_modulus"]
    off = abs(entry["value"] - 5e4)
    assert off > 5.0 * noise and 0.3 * off < entry["std"] < 3.0 * off
