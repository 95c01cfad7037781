"""The loop on recorded bars: a wall that is met late, and a weight that hangs in one of two recordings."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SIGMA, SPACING, recorded
from mphygs.capture.holds import Load
from mphygs.diagnose.wall import Plane
from mphygs.extend import first_fit as first_fit_module
from mphygs.extend.discovery import discover_effects
from mphygs.extend.first_fit import first_fit
from mphygs.extend.first_window import tractable_window
from mphygs.fit import schedule
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.placement import masses_of_loads
from mphygs.fit.schedule import TRACTABLE, ScheduleStage
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Settings
from variants_example import with_wall

FREE = ("part0.youngs_modulus",)
YOUNG = 4e4
FRAMES = 48


# ---- a wall that is met late ------------------------------------------------------------------
@cache
def late_floor(growth: float, height: float) -> tuple[Experiment, Belief, int]:
    """A bar shaken ever harder until it strikes a floor, and the frame in which it does so."""
    time = np.arange(FRAMES) / FRAMES
    motion = ((0.001 + growth * time**3) * np.sin(40.0 * time))[:, None] * [0.0, 0.0, 1.0]
    capture = bar_capture(
        frames=FRAMES, fps=100.0, rest="equilibrium", motion=motion, fit=(0, FRAMES), sigma=SIGMA
    )
    belief = bar_belief(capture, youngs_modulus=YOUNG, prestress="equilibrium", free=FREE)
    free = recorded(capture, belief).sequence("a").markers.position
    walled = recorded(capture, with_wall(belief, Plane(np.array([0.0, 0.0, 1.0]), height)))
    apart = np.abs(walled.sequence("a").markers.position - free).max(axis=(1, 2))
    return Experiment.of(walled, Settings(SPACING, workers=1)), belief, int(np.argmax(apart > 2.0 * SIGMA))


@pytest.mark.parametrize(("growth", "height", "share"), [(0.03, -0.0055, 0.65), (0.02, -0.006, 1.0)])
def test_what_is_met_late_is_seen_from_the_model_of_the_frames_before(
    growth: float, height: float, share: float
) -> None:
    experiment, belief, struck = late_floor(growth, height)
    step = first_fit(experiment, belief, SPACING)
    assert step.assessment.worst > 20.0
    # Nothing is off in the first half, which the fit has passed.
    assert step.halfway is not None and step.halfway[FREE[0]].value == pytest.approx(YOUNG, rel=0.01)
    said: list[str] = []
    found, solution = tractable_window(experiment, step, SPACING, said.append)
    assert found == pytest.approx(share) and solution.reason == "seen from before"
    # The frames that are looked at reach beyond the blow, those that were fitted do not.
    fitted = [line for line in said if line.startswith("window of")]
    assert found * FRAMES > struck > 0.55 * FRAMES and len(fitted) == 3
    error = solution.belief[FREE[0]].value / YOUNG - 1.0
    assert abs(error) < 0.01
    # All of the misfit that is seen comes after the blow.
    rows = experiment.observations["a"].whitener(0, round(found * FRAMES)).frame
    residual = solution.evaluation.residual[: solution.evaluation.data_rows]
    assert np.sqrt(np.mean(residual[rows < struck] ** 2)) < 1.15
    assert np.sqrt(np.mean(residual[rows >= struck] ** 2)) > 3.0


def test_what_is_gross_on_the_screening_grid_is_not_dwelt_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first fit of a model that lacks a wall: fewer Jacobians there, no tangents on all frames."""
    experiment, belief, _ = late_floor(0.03, -0.0055)
    asked: list[float] = []

    def fit(*_: object, plan: tuple[ScheduleStage, ...], **__: object) -> tuple[Solution, None]:
        asked[:] = [stage.gross for stage in plan]
        evaluation = experiment.problem(SPACING).evaluate(belief)
        return Solution(belief, evaluation, (evaluation.cost,), True, "kept"), None

    monkeypatch.setattr(first_fit_module, "fit_belief", fit)
    for deciding, gross in ((0.8 * SPACING, TRACTABLE), (SPACING, np.inf)):
        monkeypatch.setattr(schedule, "deciding_spacing", lambda _capture, d=deciding: d)
        step = first_fit(experiment, belief, SPACING)
        assert step.assessment.worst > 20.0 and step.compared["a"].jacobian.shape[-1] == 0
        assert set(asked) == {gross}


# ---- a wall, and nothing else asked for -------------------------------------------------------
def test_a_wall_alone_can_be_asked_for() -> None:
    normal = np.array([-0.1, 0.15, 1.0]) / np.linalg.norm([-0.1, 0.15, 1.0])
    struck = np.array([0.055, 0.01, -0.012])
    capture = bar_capture(frames=20, fps=100.0, sigma=SIGMA, fit=(0, 14))
    capture = replace(capture, sequences=(replace(capture.sequence("a"), predict=(14, 20)),))
    belief = bar_belief(capture, youngs_modulus=2e4, free=FREE)
    # Made on another grid than the one that looks at it.
    walled = recorded(capture, with_wall(belief, Plane(normal, float(normal @ struck))), 0.0085)
    experiment = Experiment.of(walled, Settings(SPACING, workers=1))
    found = discover_effects(experiment, belief, SPACING, names=("contact",))
    first, last = found.steps
    assert last.added == ("contact",) and last.solution.belief.effects == ("contact",)
    assert last.assessment.worst < 0.2 * first.assessment.worst
    model = last.belief
    n = np.array([model[f"contact.n_{a}"].value for a in "xyz"])
    n /= np.linalg.norm(n)
    assert np.degrees(np.arccos(n @ normal)) < 10.0
    assert abs(n @ struck - model["contact.d"].value) < 0.15 * SPACING
    assert model[FREE[0]].value == pytest.approx(2e4, rel=0.1)


# ---- a weight that hangs in one recording -----------------------------------------------------
MASS, ETA = 6e-3, 30.0
HUNG = Load(np.array([[0.05, 0.0, 0.0], [0.06, 0.02, 0.02]]), np.array([0.0, 0.0, -9.81 * MASS]), 0)


@cache
def hanging() -> tuple[Experiment, Belief]:
    """Two recordings of a shaken viscous bar, one with a weight, and the elastic model of it."""
    frames = 36
    shake = 0.008 * np.sin(np.linspace(0.0, 16.0, frames))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(
        frames=frames, fps=80.0, rest="equilibrium", motion=shake, fit=(0, 24), sigma=SIGMA
    )
    plain = replace(capture.sequence("a"), predict=(24, frames))
    capture = replace(capture, sequences=(plain, replace(plain, name="b", loads=(HUNG,))))
    belief = bar_belief(capture, youngs_modulus=YOUNG, prestress="equilibrium", free=FREE)
    weight = masses_of_loads(capture, ["a", "b"])[0]
    truth = belief.with_effect("viscosity", {"eta": ETA}).with_effect("attached_mass", {"m": MASS}, weight)
    return Experiment.of(recorded(capture, truth), Settings(SPACING, workers=1)), belief


def test_the_simplest_recording_is_explained_first_and_the_weight_then() -> None:
    experiment, belief = hanging()
    said: list[str] = []
    names = ("viscosity", "mass_damping", "attached_mass", "gravity")
    found = discover_effects(experiment, belief, SPACING, names=names, report=said.append)
    assert "first a: no load pulls there" in said
    assert any(line.startswith("seen from a: ") for line in said)
    assert [step.added for step in found.steps] == [(), ("viscosity",), ("attached_mass",)]
    assert (found.verdict, found.effects) == ("missing", ("viscosity", "attached_mass"))
    # Every step is one of both recordings.
    assert all(set(step.compared) == {"a", "b"} for step in found.steps)
    model = found.steps[-1].belief
    assert model["viscosity.eta"].value == pytest.approx(ETA, rel=0.1)
    assert model["attached_mass.m"].value == pytest.approx(MASS, rel=0.1)
    assert experiment.whole == ()
