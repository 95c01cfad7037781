"""Where and when an effect is wanted, and what would have to drift, in a recorded object."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, recorded
from mphygs.compare.allowance import Allowance
from mphygs.compare.residual_projection import project_out
from mphygs.diagnose.local_scores import STRETCH, Spots
from mphygs.diagnose.rank import rank
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.simulate.prediction import Settings

FREE = ("part0.youngs_modulus", "part1.youngs_modulus")
FRAMES = 30


@pytest.fixture(scope="module")
def scene() -> tuple:
    """Two shaken recordings at their truth; the second is off by what `part1.youngs_modulus` does, in its
    frames 10 to 19 on part1 alone."""
    shake = 0.006 * np.sin(np.linspace(0.0, 9.0, FRAMES))[:, None] * [0.3, 1.0, 0.0]
    capture = bar_capture(lengths=(0.03, 0.03), frames=FRAMES, fps=60.0, motion=shake, fit=(0, FRAMES))
    capture = replace(capture, sequences=(capture.sequence("a"), replace(capture.sequence("a"), name="b")))
    truth = bar_belief(capture, youngs_modulus=8e4, free=FREE)
    experiment = Experiment.of(recorded(capture, truth, SPACING), Settings(SPACING, workers=1))
    problem = experiment.problem(SPACING)
    return experiment, problem, problem.evaluate(truth), truth


def test_what_would_have_to_drift_is_told_with_its_place_and_time(scene: tuple) -> None:
    experiment, problem, evaluation, _truth = scene
    rows, jacobian = evaluation.data_rows, -evaluation.jacobian
    first, last = problem.ranges["b"]
    whitener = experiment.observations["b"].whitener(first, last)
    part = problem.predictors["b"].attachment.part[whitener.marker]
    there = (part == 1) & (whitener.frame >= 10) & (whitener.frame < 20)
    residual = np.r_[evaluation.residual[:rows], np.zeros(len(jacobian) - rows)]
    wrong = residual.copy()
    own = jacobian[evaluation.rows["b"], 1]
    size = 30.0 / np.linalg.norm(own[there])
    wrong[evaluation.rows["b"]] += np.where(there, size * own, 0.0)
    spots = Spots.of(experiment, problem, wrong, jacobian)
    assert len(spots.projection.basis) == len(wrong) and len(jacobian) > rows, "priors are rows as well"
    found = spots.of_columns(jacobian, FREE)
    assert (found[0].sequence, found[0].part, found[0].frames) == ("b", "part1", (10, 20))
    assert found[0].parameter == FREE[1] and 0.5 < found[0].z / 30.0 < 1.01
    # Its own measure: what is left there of the column, beside what the fit absorbs.
    local = np.zeros(len(wrong))
    local[evaluation.rows["b"]] = np.where(there, own, 0.0)
    freed = project_out(jacobian).remaining(local)
    assert found[0].z == pytest.approx(float(freed @ wrong) / np.linalg.norm(freed), rel=1e-6)
    # Noise alone calls for nothing.
    assert Spots.of(experiment, problem, residual, jacobian).of_columns(jacobian, FREE) == ()


def test_stretches_are_of_each_sequence_and_the_grids_share_is_allowed_for(scene: tuple) -> None:
    experiment, problem, _evaluation, truth = scene
    uneven = problem.with_ranges({"a": (0, 23), "b": (4, FRAMES)})
    evaluation = uneven.evaluate(truth)
    rows, jacobian = evaluation.data_rows, -evaluation.jacobian
    residual = np.r_[evaluation.residual[:rows], np.zeros(len(jacobian) - rows)]
    spots = Spots.of(experiment, uneven, residual, jacobian)
    for name, (first, last) in uneven.ranges.items():
        mine = [frames for sequence, _part, frames in spots.places if sequence == name]
        assert min(a for a, _ in mine) == first and max(b for _, b in mine) == last
    # What a refinement of the grid would change as much is the grid's, wherever it is.
    change = np.zeros(len(residual))
    change[:rows] = np.cos(np.arange(rows))
    off = residual + change
    (first, *_) = Spots.of(experiment, uneven, off, jacobian).of_columns(change[:, None], ("e",))
    assert first.z > 5.0
    known = Allowance(directions=change[:, None])
    assert Spots.of(experiment, uneven, off, jacobian, known).of_columns(change[:, None], ("e",)) == ()


def test_a_ranking_tells_where_and_when_its_effects_are_wanted(scene: tuple) -> None:
    experiment, _problem, _evaluation, truth = scene
    capture = recorded(experiment.capture, truth.with_effect("mass_damping", {"alpha": 2.0}), SPACING)
    own = Experiment.of(capture, Settings(SPACING, workers=1))
    fitted = minimise(own.problem(SPACING), truth)
    found = rank(
        own, fitted.belief, fitted.evaluation, SPACING,
        generator=np.random.default_rng(0), names=("mass_damping", "plasticity"), trials=False,
    )  # fmt: skip
    (entry,) = found.entries
    assert 0 < len(entry.spots) <= 3
    sizes = [abs(spot.z) for spot in entry.spots]
    assert sizes == sorted(sizes, reverse=True) and sizes[0] > 4.0
    # A drag is wanted with its own sign; where the bar moves most.
    assert all(spot.parameter == "alpha" and spot.z > 0.0 for spot in entry.spots)
    assert entry.spots[0].part == "part1"
    assert all(spot.frames[1] - spot.frames[0] == STRETCH for spot in (*entry.spots, *found.drift))
    assert found.drift and {spot.parameter for spot in found.drift} <= set(FREE)
