"""Another effect in the place of one that was found while something else was missing."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, excess_of, recorded
from mphygs.extend import effect_exchange
from mphygs.extend.conclusion import conclude
from mphygs.extend.effect_exchange import with_effects_exchanged
from mphygs.extend.step import Step
from mphygs.extend.steps import step_at
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Settings

ALPHA, TILT = 1.0, 1.5
NAMES = ("mass_damping", "viscosity", "wind")


@cache
def scene() -> tuple[Experiment, Belief]:
    """A bar that its mass damps, under a tilted gravity, and its elastic model."""
    capture = bar_capture(frames=30, fps=100.0, fit=(0, 30))
    elastic = bar_belief(capture, youngs_modulus=6e4, free=("part0.youngs_modulus",))
    truth = elastic.with_effect("mass_damping", {"alpha": ALPHA})
    truth = truth.with_effect("gravity", {"delta_g_y": TILT})
    return Experiment.of(recorded(capture, truth), Settings(SPACING, workers=1)), elastic


def fitted(belief: Belief, *added: str, spacing: float = SPACING) -> Step:
    experiment, _ = scene()
    found = minimise(experiment.problem(spacing), experiment.starting(belief), iterations=10)
    return step_at(experiment, found.belief, spacing, added=added)


def steps_with(name: str, values: dict[str, float], spacing: float = SPACING) -> list[Step]:
    """The elastic model, a damping, and gravity beside it, each fitted."""
    damped = scene()[1].with_effect(name, values)
    both = damped.with_effect("gravity", {"delta_g_y": TILT})
    return [fitted(scene()[1]), fitted(damped, name), fitted(both, "gravity", spacing=spacing)]


def exchange_of(steps: list[Step], said: list[str]) -> Step | None:
    generator = np.random.default_rng(0)
    return with_effects_exchanged(scene()[0], steps, SPACING, generator, names=NAMES, report=said.append)


def test_the_right_effect_takes_the_place_of_one_found_before_it_could_be_told() -> None:
    steps, said = steps_with("viscosity", {"eta": 5.0}), []
    assert steps[-1].explained, "the wrong damping passes for the right one"
    found = exchange_of(steps, said)
    assert found is not None and said[-1] == "mass_damping in the place of viscosity"
    assert (found.added, found.dropped) == (("mass_damping",), ("viscosity",))
    assert set(found.belief.effects) == {"mass_damping", "gravity"}
    assert found.ties == ("wind",), "it blows as the bar moves, and is as good; the viscosity is not"
    assert found.belief["mass_damping.alpha"].value == pytest.approx(ALPHA, rel=0.05)
    assert found.assessment.worst < steps[-1].assessment.worst - 0.05
    assert conclude([*steps, found], [], []).effects == ("gravity", "mass_damping")
    # Once more, from where a loop that was stopped goes on: at the noise nothing is asked.
    assert exchange_of([*steps, found], []) is None


@pytest.mark.parametrize("spacing", [SPACING, SPACING / 1.3])
def test_what_led_first_is_asked_again_near_the_floor_as_well(spacing: float) -> None:
    # On a finer grid than rivals are tried on they have to be brought to it.
    steps = steps_with("viscosity", {"eta": 5.0}, spacing)
    found = steps[-1].assessment
    times = 1.3 / found.worst
    more = {name: {k: times * v for k, v in ranges.items()} for name, ranges in found.ratio.items()}
    unexplained = replace(steps[-1], assessment=replace(found, ratio=more, adequate=False))
    assert not unexplained.explained
    after = exchange_of([*steps[:-1], unexplained], [])
    assert after is not None and (after.added, after.dropped) == (("mass_damping",), ("viscosity",))
    assert after.spacing == spacing


def test_the_right_effect_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(effect_exchange, "AT_FLOOR", 0.0)
    steps, said = steps_with("mass_damping", {"alpha": 0.5}), []
    assert exchange_of(steps, said) is None
    assert "what may stand in the place of mass_damping, now that gravity is in the model" in said
    assert any(line.startswith("mass_damping: ") for line in said), "it was held against itself"


def test_nothing_is_asked_of_a_model_at_the_noise_or_far_from_it() -> None:
    right, said = steps_with("mass_damping", {"alpha": 0.5}), []
    assert right[-1].assessment.worst < effect_exchange.AT_FLOOR
    assert exchange_of(right, said) is None and not said
    far = steps_with("viscosity", {"eta": 5.0})[:2]
    assert not far[-1].explained
    assert exchange_of(far, said) is None and not said
    # What was added last, or taken out again, is not asked.
    alone = [far[0], steps_with("viscosity", {"eta": 5.0})[-1]]
    assert exchange_of(alone, said) is None and not said


def test_what_was_taken_out_may_come_back() -> None:
    steps = steps_with("viscosity", {"eta": 5.0})
    gone = replace(steps[-1], added=("wind",), dropped=("viscosity",))
    back = replace(steps[-1], added=("viscosity",), dropped=("gravity",))
    assert conclude([*steps, gone], [], []).effects == ("gravity", "wind")
    assert conclude([*steps, gone, back], [], []).effects == ("wind", "viscosity")


@pytest.mark.parametrize(("excess", "taken"), [(0.05, True), (0.3, False)])
def test_what_explains_less_takes_no_place(
    excess: float, taken: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps = steps_with("viscosity", {"eta": 5.0})
    rival = replace(steps[-1], added=("mass_damping",), assessment=excess_of(excess))
    monkeypatch.setattr(effect_exchange, "best_of_rivals", lambda *_: rival)
    found = exchange_of(steps, [])
    assert (found is not None) is taken
