"""The loop on recorded bars: nothing missing, one thing, two, a wall, and candidates that misbehave."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch

from bar_capture import bar_belief, bar_capture
from extend_example import SIGMA, SPACING, recorded
from mphygs.capture.holds import Load
from mphygs.diagnose.planes import Plane, sphere, touched_planes
from mphygs.diagnose.trials import met
from mphygs.extend.contend import Predictive, gain_of
from mphygs.extend.discover import discover
from mphygs.extend.rounds import assimilated, simplest
from mphygs.fit.experiment import Experiment
from mphygs.fit.placement import masses_of_loads
from mphygs.model import registry, user_effect
from mphygs.model.belief import Belief
from mphygs.model.registry import ParameterSpec
from mphygs.simulate.prediction import Settings

FREE = ("part0.youngs_modulus",)
YOUNG, ETA, FRAMES = 4e4, 30.0, 36
NAMES = ("viscosity", "mass_damping", "gravity", "attached_mass")


@cache
def shaken(*effects: tuple[str, tuple[tuple[str, float], ...]], seed: int = 0) -> tuple[Experiment, Belief]:
    """A shaken bar with hidden effects, and the elastic model of it, far too stiff."""
    shake = 0.008 * np.sin(np.linspace(0.0, 16.0, FRAMES))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(frames=FRAMES, fps=80.0, motion=shake, fit=(0, 24), sigma=SIGMA)
    capture = replace(capture, sequences=(replace(capture.sequence("a"), predict=(24, FRAMES)),))
    belief = bar_belief(capture, youngs_modulus=YOUNG, free=FREE)
    truth = belief
    for name, values in effects:
        truth = truth.with_effect(name, dict(values))
    made = recorded(capture, truth)
    return Experiment.of(made, Settings(SPACING, workers=1)), belief.with_parameter(FREE[0], value=2e5)


def fresh(experiment: Experiment) -> Experiment:
    return Experiment.of(experiment.capture, experiment.settings)


VISCOUS = ("viscosity", (("eta", ETA),))


def test_a_model_that_needs_nothing_gets_nothing() -> None:
    experiment, belief = shaken()
    found = discover(fresh(experiment), belief, SPACING, names=NAMES)
    assert (found.verdict, found.effects, len(found.steps)) == ("adequate", (), 1)
    assert found.steps[0].belief[FREE[0]].value == pytest.approx(YOUNG, rel=0.03)


def test_what_is_missing_is_named_and_the_error_falls_in_unseen_frames() -> None:
    experiment, belief = shaken(VISCOUS)
    found = discover(fresh(experiment), belief, SPACING, names=NAMES)
    assert (found.verdict, found.effects) == ("missing", ("viscosity",))
    before, after = (step.assessment.ratio["a"]["predict"] for step in found.steps)
    assert before > 3.0 and after < 1.15
    assert found.steps[-1].belief["viscosity.eta"].value == pytest.approx(ETA, rel=0.1)
    # The table has a row for every candidate, and says what became of it.
    rows = {row["effect"]: row for row in found.table}
    assert set(rows) == set(NAMES) and rows["viscosity"]["gain"] > 2.0 * rows["viscosity"]["gain_se"]
    assert all(row["gain"] is not None or row["struck"] for row in found.table)


def test_a_loop_that_was_stopped_goes_on_to_the_same_numbers() -> None:
    experiment, belief = shaken(VISCOUS)
    whole = discover(fresh(experiment), belief, SPACING, names=NAMES)
    rest = discover(fresh(experiment), belief, SPACING, names=NAMES, start=whole.steps[:1])
    assert rest.effects == whole.effects
    keys = [p.key for p in whole.steps[-1].belief.free]
    assert [rest.steps[-1].belief[k].value for k in keys] == [whole.steps[-1].belief[k].value for k in keys]


def test_two_effects_are_found_one_after_the_other() -> None:
    experiment, belief = shaken(VISCOUS, ("gravity", (("delta_g_y", 2.5), ("delta_g_z", 1.0))))
    found = discover(fresh(experiment), belief, SPACING, names=NAMES)
    assert found.verdict == "missing" and set(found.effects) == {"viscosity", "gravity"}
    model = found.steps[-1].belief
    assert model["viscosity.eta"].value == pytest.approx(ETA, rel=0.15)
    assert model["gravity.delta_g_y"].value == pytest.approx(2.5, rel=0.15)


def test_under_feedback_a_model_far_off_is_near_and_its_materials_are_right() -> None:
    experiment, belief = shaken(("mass_damping", (("alpha", 6.0),)))
    own = fresh(experiment)
    free = own.problem(SPACING).evaluate(belief, jacobian=False).misfit
    found = assimilated(own, belief, SPACING)
    assert free > 20.0 and found.solution.evaluation.misfit < 0.2 * free
    assert found.belief[FREE[0]].value == pytest.approx(YOUNG, rel=0.25)


# ---- candidates that misbehave ------------------------------------------------------------------
def force_of(scale: float) -> object:
    def force(self: object, state: object, parameters: dict) -> torch.Tensor:
        # Finite at its null, and beyond all bounds or divided by zero as soon as it acts.
        k = parameters["k"]
        return k * state.velocity * state.mass[:, None] * scale + 0.0 * state.velocity / (k - k + 1.0)

    return force


@pytest.fixture
def misbehaving() -> Iterator[tuple[str, ...]]:
    spec = (ParameterSpec("k", "1/s", null=0.0, lower=0.0, upper=1e12, scale=1e3),)

    def broken(self: object, state: object, parameters: dict) -> torch.Tensor:
        return parameters["k"] / torch.zeros_like(state.velocity)

    def raises(self: object, state: object, parameters: dict) -> torch.Tensor:
        raise FloatingPointError("it cannot be had")

    functions = {"blows_up": force_of(1e9), "divides": broken, "raises_at_once": raises}
    for name, function in functions.items():
        made = type(name.title(), (), {"name": name, "parameters": spec, "force": function})
        user_effect.register_effect(made)
    yield tuple(functions)
    for name in functions:
        registry._USER.pop(name)
        user_effect._IMPLEMENTATIONS.pop(name)


def test_a_candidate_that_cannot_be_simulated_is_struck_off_and_the_loop_goes_on(
    misbehaving: tuple[str, ...],
) -> None:
    experiment, belief = shaken(VISCOUS)
    found = discover(fresh(experiment), belief, SPACING, names=("viscosity", *misbehaving))
    assert (found.verdict, found.effects) == ("missing", ("viscosity",))
    rows = {row["effect"]: row for row in found.table}
    assert all(rows[name]["struck"] for name in ("divides", "raises_at_once"))


# ---- a wall, and nothing else asked for ---------------------------------------------------------
def test_a_wall_alone_can_be_asked_for() -> None:
    normal = np.array([-0.1, 0.15, 1.0]) / np.linalg.norm([-0.1, 0.15, 1.0])
    struck = np.array([0.055, 0.01, -0.012])
    capture = bar_capture(frames=20, fps=100.0, sigma=SIGMA, fit=(0, 14))
    capture = replace(capture, sequences=(replace(capture.sequence("a"), predict=(14, 20)),))
    belief = bar_belief(capture, youngs_modulus=2e4, free=FREE)
    plane = Plane(tuple(normal), float(normal @ struck), 1.0)
    wall = met(belief, registry.effect("contact"), plane).belief
    experiment = Experiment.of(recorded(capture, wall, 0.0085), Settings(SPACING, workers=1))
    found = discover(experiment, belief, SPACING, names=("contact",))
    first, last = found.steps
    assert last.added == ("contact",) and last.belief.effects == ("contact",)
    assert last.assessment.worst < 0.2 * first.assessment.worst
    assert last.belief[FREE[0]].value == pytest.approx(2e4, rel=0.1)


def test_planes_are_those_that_the_misfit_pushes_off() -> None:
    """Points that swing above a floor and are pushed up where they come near to it."""
    time = np.linspace(0.0, 6.0, 60)
    rest = np.stack(np.meshgrid([0.0, 0.01, 0.02], [0.0, 0.01], [0.05]), axis=-1).reshape(-1, 3)
    height = 0.03 * np.cos(time)
    surface = rest + height[:, None, None] * np.array([0.0, 0.3, 1.0])
    push = np.zeros_like(surface)
    push[height < -0.027, :, 2] = 1e-3
    best, *_ = touched_planes(surface, rest, push, rest)
    assert best.normal[2] > 0.9 and best.gain > 0.5
    assert np.allclose(np.linalg.norm(sphere(50), axis=1), 1.0)


# ---- a weight that hangs in one recording -------------------------------------------------------
MASS = 6e-3
HUNG = Load(np.array([[0.05, 0.0, 0.0], [0.06, 0.02, 0.02]]), np.array([0.0, 0.0, -9.81 * MASS]), 0)


def test_a_load_is_found_to_be_a_weight_with_inertia() -> None:
    """Two recordings of a viscous bar, one with a weight that the capture states as a force alone."""
    shake = 0.008 * np.sin(np.linspace(0.0, 16.0, FRAMES))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(frames=FRAMES, fps=80.0, rest="equilibrium", motion=shake, fit=(0, 24), sigma=SIGMA)
    plain = replace(capture.sequence("a"), predict=(24, FRAMES))
    capture = replace(capture, sequences=(plain, replace(plain, name="b", loads=(HUNG,))))
    belief = bar_belief(capture, youngs_modulus=YOUNG, prestress="equilibrium", free=FREE)
    weight = masses_of_loads(capture, ["a", "b"])[0]
    truth = belief.with_effect("viscosity", {"eta": ETA}).with_effect("attached_mass", {"m": MASS}, weight)
    experiment = Experiment.of(recorded(capture, truth), Settings(SPACING, workers=1))
    found = discover(experiment, belief, SPACING, names=NAMES)
    assert found.verdict == "missing" and set(found.effects) == {"viscosity", "attached_mass"}
    model = found.steps[-1].belief
    assert model["viscosity.eta"].value == pytest.approx(ETA, rel=0.1)
    assert model["attached_mass.m"].value == pytest.approx(MASS, rel=0.1)


# ---- who is taken -------------------------------------------------------------------------------
def scores(*blocks: float) -> Predictive:
    count = np.full(len(blocks), 100.0)
    return Predictive(-0.5 * count * np.array(blocks), np.arange(len(blocks)) < 2, count)


def test_the_simpler_of_two_that_are_not_told_apart_is_taken() -> None:
    capture = bar_capture(frames=8, fps=60.0)
    belief = bar_belief(capture, free=FREE)
    one, two = belief.with_effect("viscosity"), belief.with_effect("relaxation")
    alike = [(two, "relaxation", scores(1.0, 1.0, 1.0)), (one, "viscosity", scores(1.001, 1.0, 1.001))]
    assert simplest(alike, 0.01) == (1, ("relaxation",))
    apart = [(two, "relaxation", scores(1.0, 1.0, 1.0)), (one, "viscosity", scores(1.5, 1.6, 1.55))]
    assert simplest(apart, 0.01) == (0, ())


def test_a_gain_is_of_unseen_blocks_with_the_error_that_their_scatter_gives() -> None:
    before, after = scores(9.0, 9.0, 4.0, 2.0), scores(1.0, 1.0, 1.0, 1.0)
    gain, error = gain_of(before, after, 1.0)
    assert gain == pytest.approx(0.5 * 100.0 * (3.0 + 1.0))
    assert error == pytest.approx(np.sqrt(2.0) * np.std([150.0, 50.0], ddof=1))
    assert gain_of(before, after, 2.0)[0] == pytest.approx(gain / 2.0)
