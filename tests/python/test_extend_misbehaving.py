"""Candidates that cannot be simulated: each is lost, the loop is not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
import torch

from bar_capture import bar_belief, bar_capture
from extend_example import SIGMA, SPACING, recorded
from mphygs.extend.discovery import discover_effects
from mphygs.fit.experiment import Experiment
from mphygs.model import registry, user_effect
from mphygs.model.belief import Belief
from mphygs.model.descriptor import ParameterSpec
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.settings import Settings
from mphygs.simulate.timeline import timeline_of

FREE = ("part0.youngs_modulus",)
YOUNG, ETA, FRAMES = 4e4, 30.0, 36


def viscous() -> tuple[Experiment, Belief]:
    """A shaken bar with a hidden viscosity, and the elastic model of it."""
    shake = 0.008 * np.sin(np.linspace(0.0, 16.0, FRAMES))[:, None] * [0.3, 1.0, 0.4]
    capture = bar_capture(frames=FRAMES, fps=80.0, motion=shake, fit=(0, 24), sigma=SIGMA)
    capture = replace(capture, sequences=(replace(capture.sequence("a"), predict=(24, FRAMES)),))
    belief = bar_belief(capture, youngs_modulus=YOUNG, free=FREE)
    made = recorded(capture, belief.with_effect("viscosity", {"eta": ETA}))
    return Experiment.of(made, Settings(SPACING, workers=1)), belief


def blows_up(self: object, state: object, parameters: dict) -> torch.Tensor:
    return parameters["k"] * state.velocity * state.mass[:, None] * 1e9


def divides(self: object, state: object, parameters: dict) -> torch.Tensor:
    return parameters["k"] / torch.zeros_like(state.velocity)


def raises(self: object, state: object, parameters: dict) -> torch.Tensor:
    raise FloatingPointError("it cannot be had")


@pytest.fixture(params=[blows_up, divides, raises], ids=lambda f: f.__name__)
def misbehaving(request: pytest.FixtureRequest) -> Iterator[str]:
    spec = (ParameterSpec("k", "1/s", null=0.0, lower=0.0, upper=1e12, scale=1e3),)
    name = f"own_{request.param.__name__}"
    user_effect.register_effect(
        type("Own", (), {"name": name, "parameters": spec, "force": request.param})
    )
    yield name
    registry._USER.pop(name)
    user_effect._IMPLEMENTATIONS.pop(name)


def test_the_loop_goes_on_without_it(misbehaving: str) -> None:
    experiment, belief = viscous()
    found = discover_effects(experiment, belief, SPACING, names=("viscosity", misbehaving))
    assert (found.verdict, found.effects) == ("missing", ("viscosity",))
    assert found.steps[-1].belief["viscosity.eta"].value == pytest.approx(ETA, rel=0.1)
    rows = {row["effect"]: row for row in found.table}
    assert set(rows) == {"viscosity", misbehaving} and rows["viscosity"]["struck"] is None
    # With its reason; one that does nothing at its null is simulated there, and lost later.
    reason, blew_up = rows[misbehaving]["struck"], misbehaving.endswith("blows_up")
    assert reason and (blew_up or "own_" in reason or reason.startswith("unstable"))


@pytest.mark.parametrize("substep", [0.0, -1e-3, float("nan"), 1e-30])
def test_a_substep_that_vanishes_is_one_of_no_simulation(substep: float) -> None:
    recording = bar_capture().sequence("a")
    with pytest.raises(SimulationError, match="no stable substep") as found:
        timeline_of(recording, 4, substep)
    assert "\n" not in str(found.value)
