"""How sure a step is of what it found."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from command_example import answer
from extend_example import SIGMA, recorded
from mphygs.capture.json_values import plain
from mphygs.capture.record import Known
from mphygs.capture.save import save_capture
from mphygs.commands import fit
from mphygs.extend.candidate_table import with_fitted_numbers
from mphygs.extend.finer_grid import on_finer_grid
from mphygs.extend.grids import with_budget
from mphygs.extend.step import Step, from_grid_to_grid, known_budget
from mphygs.extend.step_uncertainty import bounded, uncertainty
from mphygs.extend.steps import restored, run_at, state_of, step_at, step_document, steps_text
from mphygs.fit.belief_document import document_of_belief
from mphygs.fit.boundary_share import boundary_columns
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import covariance, minimise
from mphygs.fit.of_run import experiment_of
from mphygs.fit.residual_correlation import widened_by_correlation
from mphygs.fit.run import load_run
from mphygs.fit.tables import parameters_of
from mphygs.simulate.prediction import Settings

COARSE, FINER, FINE = 0.01, 0.008, 0.005
KEY = "part0.youngs_modulus"


def test_a_coarse_grid_is_not_sure_of_the_stiffness() -> None:
    """Recorded on a fine grid and fitted on a coarse one, the stiffness is off by many of the noise's
    deviations, and by few of those that a refinement adds."""
    capture = bar_capture(frames=24, fps=100.0, fit=(0, 24))
    truth = bar_belief(capture, youngs_modulus=6e4, free=(KEY,))
    experiment = Experiment.of(recorded(capture, truth, FINE), Settings(COARSE, workers=1))
    belief = minimise(experiment.problem(COARSE), experiment.starting(truth), iterations=8).belief
    plain = step_at(experiment, belief, COARSE)
    assert not known_budget(plain)
    noise = covariance(plain.solution.evaluation)
    # What it leaves is not explained: all of it counts as noise, and what of it lasts besides.
    misfit = plain.solution.evaluation.misfit
    assert not plain.explained and misfit > 1.5
    spread, information, places = uncertainty(plain, experiment)
    assert not places
    lasts = widened_by_correlation(experiment.problem(COARSE), plain.solution.evaluation, noise)
    assert lasts[0, 0] > noise[0, 0]
    assert spread == pytest.approx(noise * misfit**2 + lasts)
    # A boundary that pictures leave unsure adds to that, and is taken from what the measurements say.
    part = replace(capture.parts[0], boundary=1e-4)
    unsure = replace(experiment, capture=replace(experiment.capture, parts=(part,)))
    (column,) = boundary_columns([part], belief.free)
    more, less, _ = uncertainty(plain, unsure)
    # the prior is weak beside the measurements: all of it shows
    assert more - spread == pytest.approx(np.outer(column, column), rel=0.01)
    assert less[0, 0] < information[0, 0]
    known = with_budget(experiment, plain)
    assert known_budget(known)
    off = abs(np.log(belief[KEY].value / 6e4))
    noise_std, std = (float(np.sqrt(c[0, 0])) for c in (noise, uncertainty(known, experiment).covariance))
    assert off > 5.0 * noise_std and known.explained
    assert 0.4 * off < std < 2.5 * off


def test_what_a_number_moves_from_grid_to_grid_tells_how_far_it_has_to_go() -> None:
    """An error of first order, 0.12 on 10 mm and 0.06 on 5 mm: 0.06 to go. A bound says nothing."""
    experiment, step = bar()
    coarse, spacing = step.belief, 0.5 * step.spacing
    (parameter,) = coarse.free
    there = coarse.with_parameter(KEY, value=parameter.value * np.exp(-0.06))
    moved = from_grid_to_grid(step, there, spacing)
    assert moved == {KEY: pytest.approx(-0.06)}
    assert from_grid_to_grid(step, there, step.spacing) == {}
    stuck = there.with_parameter(KEY, lower=there[KEY].value)
    assert from_grid_to_grid(step, stuck, spacing) == {}
    # It is told of the step: beside the noise, and not where a refinement says more.
    sure = replace(step, moved={})
    unsure = replace(step, moved=moved)
    noise, both = (uncertainty(s, experiment).covariance[0, 0] for s in (sure, unsure))
    assert both == pytest.approx(noise + 0.06**2)
    known = with_budget(experiment, step)
    by_refinement = uncertainty(known, experiment).covariance[0, 0]
    assert uncertainty(replace(known, moved={KEY: 1e-9}), experiment).covariance[0, 0] == by_refinement
    assert uncertainty(replace(known, moved={KEY: 0.5}), experiment).covariance[0, 0] > 0.25
    state = json.loads(json.dumps(state_of(unsure)))
    document = plain(step_document(unsure, experiment, ()))
    assert restored(experiment, state, document).moved == moved


def again(experiment: Experiment, step: Step, before: tuple[str, ...] = ()) -> Step:
    """The step from what a loop writes of it."""
    document = step_document(step, experiment, before)
    kept, told = (json.loads(json.dumps(plain(part))) for part in (state_of(step), document))
    return restored(experiment, kept, told, before)


def same(step: Step, other: Step) -> None:
    """Every number of a step, to the bit."""
    assert document_of_belief(other.belief) == document_of_belief(step.belief)
    assert np.array_equal(other.solution.evaluation.residual, step.solution.evaluation.residual)
    assert np.array_equal(other.solution.evaluation.jacobian, step.solution.evaluation.jacobian)
    for name, item in step.compared.items():
        found = other.compared[name]
        assert np.array_equal(found.predicted, item.predicted)
        assert np.array_equal(found.jacobian, item.jacobian)
        assert (found.refinement is None) == (item.refinement is None)
        assert item.refinement is None or np.array_equal(found.refinement, item.refinement)
    assert other.assessment.ratio == step.assessment.ratio
    assert other.assessment.budget == step.assessment.budget
    assert other.explained == step.explained
    grids = ("spacing", "jacobian_spacing", "refinement_spacing", "window_share")
    for key in (*grids, "added", "ties", "dropped", "reconciled", "warnings"):
        assert getattr(other, key) == getattr(step, key)


def bar() -> tuple[Experiment, Step]:
    capture = bar_capture(frames=16, fps=100.0, fit=(0, 12))
    truth = bar_belief(capture, youngs_modulus=6e4, free=(KEY,))
    experiment = Experiment.of(recorded(capture, truth, FINER), Settings(COARSE, workers=1))
    step = step_at(experiment, truth.with_parameter(KEY, value=6.1e4), COARSE)
    assert np.abs(step.solution.evaluation.jacobian).max() > 0.0
    return experiment, step


def test_a_step_is_restored_as_it_was() -> None:
    experiment, plain_step = bar()
    same(plain_step, again(experiment, plain_step))
    full = replace(
        plain_step, added=("viscosity",), ties=("wind",), window_share=0.25, reconciled=True,
        dropped=("gravity",), warnings=("something",),
    )  # fmt: skip
    same(full, again(experiment, full, ("gravity",)))
    rough = plain_step.belief.with_parameter(KEY, value=5e4)
    kept = again(experiment, replace(full, coarse_belief=rough)).coarse_belief
    assert document_of_belief(kept) == document_of_belief(rough)


def test_a_step_is_restored_with_the_grids_share() -> None:
    experiment, step = bar()
    known = with_budget(experiment, step)
    assert known.assessment.budget["discretisation"] > 0.0 == step.assessment.budget["discretisation"]
    same(known, again(experiment, known))
    # A coarser grid's word is not a finer one's.
    rough = with_budget(experiment, step, refinement_spacing=1.5 * COARSE)
    assert not np.array_equal(rough.compared["a"].refinement, known.compared["a"].refinement)
    same(rough, again(experiment, rough))


def test_a_step_is_restored_with_the_tangents_that_it_borrowed() -> None:
    experiment, step = bar()
    lent = on_finer_grid(experiment, replace(step, added=("viscosity",)))
    assert lent.jacobian_spacing == COARSE != lent.spacing
    same(lent, again(experiment, lent))


def test_a_step_and_its_run_tell_a_bound_as_a_fit_does(tmp_path: Path) -> None:
    """A bar of 20 MPa that is shaken by micrometres hardly yields: a step tells it as at least so stiff."""
    frames = 24
    shake = 1.2e-5 * np.sin(np.linspace(0.0, 9.0, frames))[:, None] * [0.2, 1.0, 0.4]
    known = Known(density={"part0": 1000.0}, poissons_ratio=0.3)
    capture = bar_capture(
        frames=frames, fps=60.0, motion=shake, fit=(0, frames), sigma=SIGMA, known=known
    )
    folder = tmp_path / "bar"
    save_capture(recorded(capture, bar_belief(capture, youngs_modulus=2e7)), folder)
    answer(fit.main, folder, "--out", tmp_path / "run", "--spacing", COARSE, "--workers", 1)
    state = load_run(tmp_path / "run")
    experiment, belief = experiment_of(state, workers=1)
    step = step_at(experiment, belief, COARSE)
    entry = step_document(step, experiment, ())["parameters"][KEY]
    assert entry == plain(state.answer)["parameters"][KEY]
    assert not entry["determined"] and entry["std"] > entry["value"]
    assert 1e4 < entry["bound"]["lower"] < 2e7 and "at least" in entry["note"]
    known = bounded(step, experiment)
    assert bounded(again(experiment, known), experiment).limits == known.limits
    assert any(entry["note"] in line for line in steps_text([plain(step_document(known, experiment, ()))]))
    # And so does the run that it ends in, whatever the first fit left.
    begun = replace(state, history=(replace(state.history[-1], misfit=40.0),))
    run_at(begun, tmp_path / "grown", step, experiment, options={}, answer=None).save()
    assert parameters_of(load_run(tmp_path / "grown"))[KEY] == entry


def test_a_table_tells_what_was_added_as_its_step_does() -> None:
    parameters = {
        "viscosity.eta": {"value": 40.0, "std": 3.0, "unit": "Pa s", "determined": True},
        "tether.k": {"value": 9e5, "std": 1e6, "unit": "N/m", "determined": False, "bound": {"lower": 2e3}},
    }
    rows = [
        {"effect": "tether", "estimate": {"k": 1e6, "anchor_x": 0.1}, "std": {"k": 2e-9, "anchor_x": 1e-3}},
        {"effect": "viscosity", "estimate": {"eta": 38.0}, "std": {"eta": 1.0}},
    ]
    told = with_fitted_numbers(rows, parameters, ("tether",))
    assert told[0]["estimate"] == {"k": 9e5, "anchor_x": 0.1} and told[0]["std"] == {}
    assert told[1] == rows[1]


def test_the_table_of_a_step_has_the_numbers_of_the_step() -> None:
    capture = bar_capture(frames=24, fps=100.0, fit=(0, 24))
    truth = bar_belief(capture, youngs_modulus=6e4, free=(KEY,)).with_effect("viscosity", {"eta": 20.0})
    experiment = Experiment.of(recorded(capture, truth, COARSE), Settings(COARSE, workers=1))
    row = {"effect": "viscosity", "estimate": {"eta": 1.0}, "std": {"eta": 1e-9}}
    step = replace(step_at(experiment, truth, COARSE, added=("viscosity",)), table=(row,))
    document = step_document(step, experiment, ())
    entry = document["parameters"]["viscosity.eta"]
    assert entry["determined"]
    assert document["table"] == [row | {"estimate": {"eta": entry["value"]}, "std": {"eta": entry["std"]}}]


def test_a_step_of_which_no_grid_told_counts_what_a_coarser_one_changes() -> None:
    """Recorded on a fine grid and fitted on a coarse one, without a refinement: the stiffness is off by many
    of the noise's deviations, and by few of those that it is told with."""
    capture = bar_capture(frames=24, fps=100.0, fit=(0, 24))
    truth = bar_belief(capture, youngs_modulus=6e4, free=(KEY,))
    experiment = Experiment.of(recorded(capture, truth, FINE), Settings(COARSE, workers=1))
    belief = minimise(experiment.problem(COARSE), experiment.starting(truth), iterations=8).belief
    step = step_at(experiment, belief, COARSE)
    off = abs(np.log(belief[KEY].value / 6e4))
    noise = np.sqrt(covariance(step.solution.evaluation)[0, 0])
    entry = step_document(step, experiment, ())["parameters"][KEY]
    assert entry["determined"] and off > 5.0 * noise
    assert 0.3 * off < entry["std"] / entry["value"] < 5.0 * off
    assert bounded(step, experiment).refitted(step.solution, step.compared, step.assessment).change is None
