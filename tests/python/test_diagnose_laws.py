"""Other elastic laws as candidates: found where strains tell them, not tried where they cannot be told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, assessment_of, recorded, step_of
from mphygs.diagnose import finite_trials, trial_ranking
from mphygs.diagnose.rank import rank
from mphygs.diagnose.ranking import Ranking
from mphygs.extend.candidate_table import candidate_rows
from mphygs.extend.model_selection import step_of as step_from
from mphygs.extend.refit import finish_refit
from mphygs.extend.refit_beginning import start_refit
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.model.belief import Belief
from mphygs.model.registry import laws
from mphygs.simulate.prediction import Settings

OTHER, SOFT = laws()[1], 3e4


def scene(truth: str | None, youngs_modulus: float, reach: float) -> tuple[Experiment, Solution, Belief]:
    """A bar shaken so far [m] by its hold, recorded with an effect, and the model fitted without it."""
    frames = 24
    shake = reach * np.sin(np.linspace(0.0, 9.0, frames))[:, None] * [0.0, 0.3, 1.0]
    capture = bar_capture(frames=frames, fps=60.0, motion=shake, fit=(0, frames))
    recording = replace(capture.sequences[0], fit=(0, 16), predict=(16, frames))
    capture = replace(capture, sequences=(recording,))
    belief = bar_belief(capture, youngs_modulus=youngs_modulus, free=("part0.youngs_modulus",))
    values = {"eta": 150.0} if truth == "viscosity" else {}
    model = belief if truth is None else belief.with_effect(truth, values)
    experiment = Experiment.of(recorded(capture, model), Settings(SPACING, workers=1))
    return experiment, minimise(experiment.problem(SPACING), belief), belief


def ranked(experiment: Experiment, fitted: Solution, *names: str) -> Ranking:
    return rank(
        experiment, fitted.belief, fitted.evaluation, SPACING,
        generator=np.random.default_rng(0), names=names or None,
    )  # fmt: skip


def test_another_law_is_found_with_its_own_modulus_and_stands_in_the_table() -> None:
    experiment, fitted, belief = scene(OTHER, SOFT, 0.008)
    found = ranked(experiment, fitted, OTHER, "viscosity", "length_scale")
    first = found.entries[0]
    assert (first.effect, first.label, first.estimate) == (OTHER, f"law {OTHER}", {})
    assert first.p_value < 1e-20 and first.statistic > 0.8 * (found.chi_square - found.rows)
    compared = experiment.compare(fitted.belief, SPACING)
    begun = start_refit(experiment, fitted, first, SPACING)
    refit = finish_refit(
        experiment, fitted, compared, first, begun, SPACING, generator=np.random.default_rng(0)
    )
    assert refit.belief.law == OTHER and refit.belief.effects == (OTHER,)
    assert refit.belief["part0.youngs_modulus"].value == pytest.approx(SOFT, rel=3e-3)
    assert refit.pays and refit.gain.accepted and refit.assessment.worst < 1.1
    # A swap: as many numbers are fitted as before, and its choice counts as one.
    assert len(refit.belief.free) == len(belief.free)
    row = candidate_rows(found, [refit], {}, fitted.belief, step_from(refit, SPACING, [refit], 1.0))[0]
    assert (row["effect"], row["numbers"], row["struck"]) == (OTHER, 1, None)
    assert row["gain"] > 1.5 * row["gain_se"] > 0.0 and row["drop"] == refit.actual_drop


def test_a_law_that_strains_do_not_tell_is_struck_off_before_any_refit() -> None:
    experiment, fitted, _ = scene("viscosity", 2e5, 0.008)
    found = ranked(experiment, fitted, OTHER, "viscosity")
    assert fitted.evaluation.misfit > 1.5 and found.entries[0].effect == "viscosity"
    (law,) = (e for e in found.entries if e.effect == OTHER)
    assert law.reason == "differs by less than noise can tell, beside numbers that are fitted"
    assert (law.statistic, law.p_value) == (0.0, 1.0)
    kept = step_of(assessment_of(1.0), added=("viscosity",))
    rows = candidate_rows(found, [], {}, fitted.belief, kept)
    assert next(row for row in rows if row["effect"] == OTHER)["struck"] == law.reason


def test_no_law_is_tried_where_noise_is_all_that_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, fitted, _ = scene(None, SOFT, 0.008)
    assert [e.effect for e in ranked(experiment, fitted, "viscosity", OTHER).entries] == ["viscosity"]
    monkeypatch.setattr(finite_trials, "SPREAD", -np.inf)
    (law,) = (e for e in ranked(experiment, fitted, "viscosity", OTHER).entries if e.effect == OTHER)
    assert law.statistic == 0.0 and not law.reason and law.p_value == 1.0
    monkeypatch.setattr(trial_ranking, "TELLS", np.inf)
    assert any(e.reason for e in ranked(experiment, fitted, OTHER).entries)
