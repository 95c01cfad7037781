"""A model that explains nearly all is asked on a grid finer than the default one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import recorded
from mphygs.extend import finer_grid as module
from mphygs.extend.finer_grid import (
    FINER,
    corrected_coarse_problem,
    fitted_by_coarse_jacobians,
    on_finer_grid,
    rival_on_coarse_grid,
)
from mphygs.extend.grids import complete, converged_fit
from mphygs.extend.step import Step
from mphygs.extend.steps import step_at
from mphygs.fit.borrowed_jacobians import fit_by_borrowed_jacobians
from mphygs.fit.experiment import Experiment
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Prediction, Predictor, Settings

FREE = ("part0.youngs_modulus",)
COARSE = 0.01
FINE = round(COARSE / FINER, 6)


def near() -> tuple[Experiment, Step]:
    """A bar recorded on the finer grid, and a step for it on the coarser one."""
    capture = bar_capture(frames=16, fps=100.0, fit=(0, 12))
    truth = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    experiment = Experiment.of(recorded(capture, truth, FINE), Settings(COARSE, workers=1))
    off = truth.with_parameter(FREE[0], value=6.6e4)
    return experiment, step_at(experiment, off, COARSE, added=("viscosity",))


def test_the_finer_grid_is_reached_by_the_tangents_of_the_coarser_one() -> None:
    experiment, before = near()
    said: list[str] = []
    after = on_finer_grid(experiment, before, said.append)
    assert (after.spacing, after.jacobian_spacing, after.added) == (FINE, COARSE, ("viscosity",))
    assert after.belief[FREE[0]].value == pytest.approx(6e4, rel=0.01)
    assert after.assessment.worst < 1.1 < before.assessment.worst
    assert after.solution.belief is after.belief
    assert after.solution.evaluation.residual == pytest.approx(
        experiment.problem(FINE).evaluate(after.belief, jacobian=False).residual
    )
    slope = experiment.problem(COARSE).evaluate(after.belief).jacobian
    assert np.abs(slope).max() > 0.0
    assert after.solution.evaluation.jacobian == pytest.approx(slope)
    assert "7.69 mm" in said[0] and "10 mm" in said[0] and "->" in said[-1]


def test_the_change_from_grid_to_grid_is_the_grids_share() -> None:
    experiment, before = near()
    after = on_finer_grid(experiment, before)
    item = after.compared["a"]
    other = experiment.compare(after.belief, COARSE)["a"]
    assert item.jacobian == pytest.approx(other.jacobian)
    assert np.abs(item.refinement).max() > 0.0
    # the whole error of the finer grid, were it of second order
    assert item.refinement * ((COARSE / FINE) ** 2 - 1.0) == pytest.approx(item.predicted - other.predicted)
    assert after.assessment.budget["discretisation"] >= 0.0


def test_its_numbers_are_left_at_what_lent_tangents_lead_to() -> None:
    experiment, before = near()
    after = on_finer_grid(experiment, before)
    assert converged_fit(experiment, after) is after
    again = fitted_by_coarse_jacobians(experiment, replace(after, belief=before.belief), FINE, COARSE)
    assert again.belief[FREE[0]].value == pytest.approx(after.belief[FREE[0]].value, rel=1e-3)


def test_what_a_rival_owes_to_the_grid_is_taken_from_the_best_step(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, before = near()
    best = on_finer_grid(experiment, before)
    damped = before.belief.with_effect("mass_damping", {"alpha": 1.0}).with_parameter(
        "mass_damping.alpha", free=True
    )
    rival = replace(before, belief=damped, added=("mass_damping",))
    fitted = fitted_by_coarse_jacobians(experiment, rival, FINE, COARSE)
    spacings: list[float] = []
    predict = Predictor.predict

    def counted(self: Predictor, *given: object, **named: object) -> Prediction:
        spacings.append(self.settings.spacing)
        return predict(self, *given, **named)

    monkeypatch.setattr(Predictor, "predict", counted)
    carried = rival_on_coarse_grid(experiment, corrected_coarse_problem(experiment, best), rival, best)
    assert spacings and set(spacings) == {COARSE}
    assert (carried.spacing, carried.jacobian_spacing, carried.added) == (FINE, COARSE, ("mass_damping",))
    assert carried.belief[FREE[0]].value == pytest.approx(fitted.belief[FREE[0]].value, rel=2e-3)
    assert abs(fitted.belief[FREE[0]].value / before.belief[FREE[0]].value - 1.0) > 0.05
    assert carried.assessment.worst == pytest.approx(fitted.assessment.worst, abs=0.02)
    # Chosen all the same, it is compared on the finer grid itself.
    whole = complete(experiment, carried)
    assert FINE in spacings
    assert whole.compared["a"].jacobian.shape[-1] == 2
    there = experiment.compare(carried.belief, FINE, jacobian=False)["a"]
    assert whole.compared["a"].predicted == pytest.approx(there.predicted)


def test_a_rival_is_led_by_tangents_of_the_screening_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, before = near()
    best = on_finer_grid(experiment, before)
    rival = replace(before, added=("gravity",))
    problem = corrected_coarse_problem(experiment, best)
    own = rival_on_coarse_grid(experiment, problem, rival, best)
    asked: list[tuple[float, bool]] = []
    predict = Predictor.predict

    def counted(self: Predictor, *given: object, **named: object) -> Prediction:
        asked.append((self.settings.spacing, bool(named.get("keys"))))
        return predict(self, *given, **named)

    monkeypatch.setattr(Predictor, "predict", counted)
    monkeypatch.setattr(module, "screening_spacing", lambda _capture: 1.4 * COARSE)
    led = rival_on_coarse_grid(experiment, problem, rival, best)
    assert asked[:2] == [(COARSE, False), (1.4 * COARSE, True)]
    assert asked.count((COARSE, True)) == 1
    assert led.belief[FREE[0]].value == pytest.approx(own.belief[FREE[0]].value, rel=2e-3)
    assert led.assessment.worst == pytest.approx(own.assessment.worst, abs=0.02)


def test_the_best_that_was_tried_is_returned() -> None:
    experiment, before = near()
    fine, coarse = experiment.problem(FINE), experiment.problem(COARSE)
    solution = fit_by_borrowed_jacobians(fine, coarse, before.belief)
    assert solution.evaluation.cost == pytest.approx(fine.evaluate(solution.belief).cost)
    assert solution.evaluation.cost < fine.evaluate(before.belief).cost


def test_no_step_where_the_finer_grid_cannot_carry_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, before = near()

    def unstable(*_: object, **__: object) -> None:
        raise SimulationError("unstable at frame 3")

    monkeypatch.setattr(module, "fit_by_borrowed_jacobians", unstable)
    said: list[str] = []
    assert on_finer_grid(experiment, before, said.append) is None
    assert said[-1] == "grid of 7.69 mm: unstable at frame 3"
