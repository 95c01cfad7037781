"""What an experiment shares: windows of frames, some of its sequences, those that windows leave whole."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, recorded, step_of
from mphygs.capture.actuators import Tendon
from mphygs.capture.format import Capture
from mphygs.capture.holds import Load
from mphygs.extend.simplest_recordings import compared_on_all, sequences_without_loads
from mphygs.extend.step import Step
from mphygs.fit.experiment import Experiment
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.prediction import Settings

PULL = Load(np.array([[0.05, 0.0, 0.0], [0.06, 0.02, 0.02]]), np.array([0.0, 0.02, 0.0]), 0)
FREE = ("part0.youngs_modulus",)


@cache
def three_recordings() -> tuple[Capture, Belief]:
    """`plain` and `late` without a load, `pulled` with one; `late` is fitted from frame 10 on."""
    capture = bar_capture(frames=40, fps=100.0, fit=(0, 40))
    one = capture.sequence("a")
    sequences = (
        replace(one, name="plain"),
        replace(one, name="late", fit=(10, 40)),
        replace(one, name="pulled", loads=(PULL,)),
    )
    truth = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    return recorded(replace(capture, sequences=sequences), truth), truth


def experiment() -> Experiment:
    return Experiment.of(three_recordings()[0], Settings(SPACING, workers=1))


# ---- windows ----------------------------------------------------------------------------------
def test_a_window_is_the_first_share_of_every_range() -> None:
    made = experiment()
    assert made.window(SPACING, 1.0) is made.problem(SPACING)
    assert made.window(SPACING, 0.5).ranges == {"plain": (0, 20), "late": (10, 25), "pulled": (0, 20)}
    # Eight frames at least.
    assert made.window(SPACING, 0.05).ranges == {"plain": (0, 8), "late": (10, 18), "pulled": (0, 8)}


def test_windows_leave_sequences_whole_that_are_explained() -> None:
    made = experiment()
    made.whole = ("plain", "late")
    window = made.window(SPACING, 0.25)
    assert window.ranges == {"plain": (0, 40), "late": (10, 40), "pulled": (0, 10)}
    made.whole = ()
    assert made.window(SPACING, 0.25).ranges["plain"] == (0, 10)
    # The bodies are those of the whole problem.
    assert window.predictors["pulled"].body is made.problem(SPACING).predictors["pulled"].body


def test_the_rows_of_a_window_are_the_first_ones_of_the_whole() -> None:
    made, (_, truth) = experiment(), three_recordings()
    whole = made.problem(SPACING).evaluate(truth, jacobian=False)
    window = made.window(SPACING, 0.5).evaluate(truth, jacobian=False)
    for name, rows in window.rows.items():
        ours, theirs = window.residual[rows], whole.residual[whole.rows[name]]
        assert len(ours) == len(theirs) // 2
        np.testing.assert_allclose(ours, theirs[: len(ours)], atol=1e-6)


# ---- some sequences ---------------------------------------------------------------------------
def test_only_some_sequences_is_as_if_the_others_were_not_recorded() -> None:
    made, (capture, truth) = experiment(), three_recordings()
    whole = made.problem(SPACING).evaluate(truth, jacobian=False)
    alone = made.only(("plain", "late"))
    assert [s.name for s in alone.capture.sequences] == ["plain", "late"]
    assert alone.fitted == {"plain": (0, 40), "late": (10, 40)}
    assert alone.compared_names() == ["plain", "late"] and alone.whole == ()
    found = alone.problem(SPACING).evaluate(truth, jacobian=False)
    assert set(found.rows) == {"plain", "late"}
    np.testing.assert_allclose(found.residual[found.rows["late"]], whole.residual[whole.rows["late"]])
    assert len(made.capture.sequences) == 3 and len(made.fitted) == 3
    with pytest.raises(KeyError):
        made.only(("nobody",))
    assert capture is made.capture


def test_what_one_experiment_leaves_out_the_other_does() -> None:
    made = experiment()
    made.problem(SPACING)
    alone = made.only(("plain",))
    alone.problem(SPACING)
    alone.observations["plain"] = alone.observations["plain"].without(np.array([True, False, False, False]))
    assert made.observations["plain"] is alone.observations["plain"]


# ---- the simplest recordings first ------------------------------------------------------------
def test_the_simplest_recordings_are_those_without_a_load() -> None:
    made = experiment()
    assert sequences_without_loads(made) == ("plain", "late")
    assert sequences_without_loads(made.only(("plain", "late"))) == ()
    assert sequences_without_loads(made.only(("pulled",))) == ()
    assert sequences_without_loads(made.only(("pulled", "late"))) == ("late",)
    # What pulls by numbers in a file is a load as well.
    pull = Tendon(np.ones(made.capture.sequence("late").frames), "pull", path=np.eye(3))
    driven = [replace(s, actuators=(pull,)) if s.name == "late" else s for s in made.capture.sequences]
    assert sequences_without_loads(replace(made, capture=replace(made.capture, sequences=tuple(driven)))) == (
        "plain",
    )


def released(belief: Belief, name: str, value: float) -> Belief:
    parameter = Parameter(f"{name}.release_shift", value, "s", -0.05, 0.05, prior_mean=0.01, prior_std=0.01)
    return replace(belief, parameters=(*belief.parameters, parameter))


def test_a_step_of_some_sequences_is_compared_on_all() -> None:
    made, (_, truth) = experiment(), three_recordings()
    first = released(released(truth, "plain", 0.03), "pulled", 0.04)
    first = first.with_parameter(FREE[0], value=9e4)
    # What was found on the simplest: another stiffness, an effect, the release of one sequence alone.
    belief = released(truth, "plain", 0.02).with_effect("viscosity", {"eta": 3.0})
    belief = belief.with_parameter("part0.density", value=900.0)
    found = replace(made_step(belief), added=("viscosity",), ties=("mass_damping",), dropped=("wind",))
    step = compared_on_all(made, first, found)
    assert step.dropped == ("wind",)
    assert (step.added, step.ties, step.spacing) == (("viscosity",), ("mass_damping",), SPACING)
    assert set(step.compared) == {"plain", "late", "pulled"}
    values = {p.key: p.value for p in step.belief.parameters}
    assert values["part0.youngs_modulus"] == 6e4 and values["viscosity.eta"] == 3.0
    assert values["plain.release_shift"] == 0.02
    # Nothing was found of the other sequence: it keeps what its first fit gave.
    assert values["pulled.release_shift"] == 0.04
    # What is known is not taken from anywhere.
    assert values["part0.density"] == 1000.0
    assert step.belief.effects == ("viscosity",)
    expected = made.problem(SPACING).evaluate(step.belief, jacobian=False).chi_square
    assert step.solution.evaluation.chi_square == pytest.approx(expected, rel=1e-4)


def test_what_only_the_other_recordings_tell_is_back_at_its_prior() -> None:
    made, (_, truth) = experiment(), three_recordings()
    first = released(truth, "pulled", 0.04)
    held = released(truth, "pulled", 0.0).with_parameter("pulled.release_shift", free=False)
    step = compared_on_all(made, first, made_step(held))
    assert step.belief["pulled.release_shift"].value == 0.01
    assert step.belief["pulled.release_shift"].free
    # So is a number that is fitted in its logarithm.
    wide = truth.with_parameter(FREE[0], prior_mean=float(np.log(5e4)), prior_std=1.0)
    step = compared_on_all(made, wide, made_step(truth.with_parameter(FREE[0], free=False)))
    assert step.belief[FREE[0]].value == pytest.approx(5e4)


def made_step(belief: Belief) -> Step:
    return replace(step_of(None), belief=belief, spacing=SPACING)


# ---- what is not computed twice ---------------------------------------------------------------
def test_a_prediction_with_its_jacobian_is_kept_for_the_next_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    _, belief = three_recordings()
    shared = experiment().only(["plain"])
    problem = shared.problem(SPACING)
    predictor, runs = problem.predictors["plain"], []
    run = predictor._runs

    def counted(*args: object) -> object:
        runs.append([p.key for _, p in args[1]])
        return run(*args)

    monkeypatch.setattr(predictor, "_runs", counted)
    # One without Jacobian is no substitute.
    alone = problem.evaluate(belief, jacobian=False)
    known = problem.evaluate(belief)
    assert runs == [[], list(FREE)] and np.array_equal(known.residual, alone.residual)
    again, less = problem.evaluate(belief), problem.evaluate(belief, jacobian=False)
    assert np.array_equal(again.jacobian, known.jacobian) and np.array_equal(less.residual, known.residual)
    assert np.array_equal(less.jacobian, known.jacobian) and len(runs) == 2
    # A comparison of the same frames, and what is asked beside other observations, needs no run either.
    assert shared.compare(belief, SPACING)["plain"].jacobian.any()
    observation = shared.observations["plain"]
    shared.observations["plain"] = replace(observation, position=observation.position + 1e-3)
    assert problem.evaluate(belief).cost > known.cost + 1.0
    # A Jacobian that is asked for late is of what was observed when the residual was.
    late = problem.evaluate(belief, jacobian=False)
    missing = observation.position.copy()
    missing[3, 0] = np.nan
    shared.observations["plain"] = replace(observation, position=missing)
    assert len(late.jacobian) == len(late.residual) > len(problem.evaluate(belief).residual)
    assert len(runs) == 2
    # Another belief, the first frames: computed.
    stiffer = belief.with_parameter(FREE[0], value=7e4)
    assert not np.array_equal(problem.evaluate(stiffer).residual, known.residual)
    assert len(shared.window(SPACING, 0.5).evaluate(belief).residual) < len(known.residual)
    assert len(runs) == 4
    # The latest few are kept.
    for factor in (1.1, 1.2, 1.3):
        problem.evaluate(belief.with_parameter(FREE[0], value=factor * 6e4))
    problem.evaluate(belief)
    assert len(runs) == 8
    predictor.forget()
    problem.evaluate(belief)
    assert len(runs) == 9
