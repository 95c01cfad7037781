"""Effects that a later one made superfluous."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, assessment_of, excess_of, recorded
from mphygs.extend import prune
from mphygs.extend.anew import anew
from mphygs.extend.discover import _conclude
from mphygs.extend.prune import pruned
from mphygs.extend.step import Step
from mphygs.extend.steps import step_at, step_document
from mphygs.fit.anew import fitted_anew
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Settings

ETA, TILT = 20.0, 1.5


@cache
def scene(tilt: float) -> tuple[Experiment, Belief]:
    """A viscous bar, gravity tilted by so much [m/s^2], and its elastic model."""
    capture = bar_capture(frames=30, fps=100.0, fit=(0, 30))
    elastic = bar_belief(capture, youngs_modulus=6e4, free=("part0.youngs_modulus",))
    truth = elastic.with_effect("viscosity", {"eta": ETA})
    if tilt:
        truth = truth.with_effect("gravity", {"delta_g_y": tilt})
    return Experiment.of(recorded(capture, truth), Settings(SPACING, workers=1)), elastic


def both(tilt: float) -> tuple[Experiment, Step, Step]:
    """The steps with gravity and then viscosity, at the truth."""
    experiment, elastic = scene(tilt)
    tilted = elastic.with_effect("gravity", {"delta_g_y": tilt})
    full = tilted.with_effect("viscosity", {"eta": ETA})
    before = step_at(experiment, tilted, SPACING, added=("gravity",))
    return experiment, before, step_at(experiment, full, SPACING, added=("viscosity",))


def test_what_is_superfluous_goes() -> None:
    experiment, before, last = both(0.0)
    said: list[str] = []
    found = pruned(experiment, last, ["gravity"], said.append)
    assert found.belief.effects == ("viscosity",) and found.added == ("viscosity",)
    assert said[0].startswith("without gravity: ")
    concluded = _conclude([step_at(experiment, scene(0.0)[1], SPACING), before, found], [], [])
    assert (concluded.verdict, concluded.effects) == ("missing", ("viscosity",))
    assert step_document(found, experiment, ("gravity", "marker_outliers"))["effects"] == [
        "marker_outliers",
        "viscosity",
    ]
    # What the user put into the first model is not the loop's to take away.
    assert pruned(experiment, last, []) is last


def test_what_is_needed_stays() -> None:
    experiment, _, last = both(TILT)
    said: list[str] = []
    assert pruned(experiment, last, ["gravity"], said.append) is last
    # It is far off after the first iterations: the rest of them, and the comparison, are saved.
    assert said[-1].endswith("given up")


def test_a_coarse_grid_leads_as_far_as_it_can(monkeypatch: pytest.MonkeyPatch) -> None:
    def lender(experiment: Experiment, spacing: float) -> Problem:
        assert spacing == SPACING
        return experiment.problem(1.5 * SPACING)

    monkeypatch.setattr(prune, "lender_of", lender)
    experiment, _, last = both(0.0)
    assert pruned(experiment, last, ["gravity"]).belief.effects == ("viscosity",)

    def own(*_: object, **__: object) -> None:
        raise AssertionError("a Jacobian of its own")

    # What is needed is far off there already.
    monkeypatch.setattr(prune, "minimise", own)
    experiment, _, last = both(TILT)
    said: list[str] = []
    assert pruned(experiment, last, ["gravity"], said.append) is last
    assert said[-1].endswith("given up")


def test_what_may_still_do_as_well_is_fitted_to_the_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prune, "FAR", 1e9)
    experiment, _, last = both(TILT)
    said: list[str] = []
    assert pruned(experiment, last, ["gravity"], said.append) is last
    assert said[-1].endswith("in the worst range")


@pytest.mark.parametrize(("rise", "goes"), [(1.04, True), (1.07, False)])
def test_what_pays_a_little_of_a_large_misfit_stays(
    rise: float, goes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment, _, last = both(0.0)
    last = replace(last, assessment=excess_of(10.0))
    monkeypatch.setattr(prune, "_far", lambda *_: False)
    monkeypatch.setattr(prune, "anew", lambda _experiment, step, _report: step)
    monkeypatch.setattr(experiment, "assess", lambda _compared: excess_of(rise * 10.0))
    assert (pruned(experiment, last, ["gravity"]).belief.effects == ("viscosity",)) is goes


def test_materials_begin_anew_where_that_is_better() -> None:
    experiment, elastic = scene(0.0)
    truth = elastic.with_effect("viscosity", {"eta": ETA})
    stuck = truth.with_parameter("part0.youngs_modulus", value=6e5)
    said: list[str] = []
    before = step_at(experiment, stuck, SPACING, added=("viscosity",))
    found = anew(experiment, before, said.append)
    assert found.belief["part0.youngs_modulus"].value == pytest.approx(6e4, rel=0.01)
    assert found.assessment.worst < 1.2 < before.assessment.worst and found.added == before.added
    assert said[-1].startswith("materials anew: cost ")
    # At the minimum nothing is gained.
    best = anew(experiment, found)
    assert best.solution.evaluation.cost <= found.solution.evaluation.cost
    assert best.belief["part0.youngs_modulus"].value == pytest.approx(6e4, rel=0.01)


def test_materials_that_do_no_better_on_half_of_the_frames_are_not_followed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    experiment, elastic = scene(0.0)
    truth = elastic.with_effect("viscosity", {"eta": ETA})
    best = anew(experiment, step_at(experiment, truth, SPACING, added=("viscosity",))).solution
    said: list[str] = []
    assert fitted_anew(experiment, best, SPACING, said.append) is best
    assert said[-1] == "materials anew: no better on 50% of the frames"
    assert not any("100%" in line for line in said)

    # First frames that lead elsewhere are not followed either.
    far = best.belief.with_parameter("part0.youngs_modulus", value=6e5)
    with monkeypatch.context() as patch:
        patch.setattr("mphygs.fit.anew.minimise", lambda *_, **__: replace(best, belief=far))
        assert fitted_anew(experiment, best, SPACING, said.append) is best
    assert said[-1] == "materials anew: astray on 50% of the frames"

    def unstable(*_: object, **__: object) -> None:
        raise SimulationError("too soft")

    monkeypatch.setattr("mphygs.fit.anew.find_scale", unstable)
    assert fitted_anew(experiment, best, SPACING) is best


def test_a_closer_fit_that_predicts_worse_is_not_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, elastic = scene(0.0)
    truth = elastic.with_effect("viscosity", {"eta": ETA})
    near = truth.with_parameter("part0.youngs_modulus", value=6.03e4)
    before = step_at(experiment, near, SPACING, added=("viscosity",))
    assert before.explained and anew(experiment, before) is not before
    monkeypatch.setattr(experiment, "assess", lambda _compared: assessment_of(5.0))
    assert anew(experiment, before) is before
