"""The gradient's own run: the states that its loss is given are the simulation's, to the last bit, reactions
among them; the gradient is the adjoint's; one run forward is all; and what a loss raises comes out."""

from __future__ import annotations

import numpy as np
import pytest

from bar_capture import bar_belief
from mphygs.simulate.core_runs import run_core_adjoint
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import EXPLICIT, IMPLICIT, MLS, TOTAL_LAGRANGIAN, Settings
from sensor_example import moved_bar

FRAMES = 5
KEY = "part0.youngs_modulus"


def scene(transfer: str, integrator: str, workers: int = 1) -> tuple:
    """A bar that two holds move, whose forces are read: predictor and belief."""
    capture = moved_bar(FRAMES)
    settings = Settings(0.015, workers=workers, dtype="float64", transfer=transfer, integrator=integrator)
    belief = bar_belief(capture, youngs_modulus=(6e4, 3e4), density=(900.0, 1200.0), free=(KEY,))
    return Predictor(capture, capture.sequences[0], settings), belief


def run_of(predictor: Predictor, belief: object) -> tuple:
    """Model, fields and schedule of all frames."""
    timeline = predictor.timeline(belief, FRAMES, predictor.stable_substep(belief))
    return predictor.model_of(belief), predictor.inputs(belief, timeline), predictor.schedule(timeline)


RUNS = [(TOTAL_LAGRANGIAN, EXPLICIT), (TOTAL_LAGRANGIAN, IMPLICIT), (MLS, EXPLICIT)]


@pytest.mark.parametrize(("transfer", "integrator"), RUNS)
def test_states_are_the_simulations_and_the_gradient_the_adjoints(transfer: str, integrator: str) -> None:
    predictor, belief = scene(transfer, integrator)
    run = run_of(predictor, belief)
    states = predictor.transfer.simulate(*run, None, None)
    random, bars, given = np.random.default_rng(0), [], []

    def loss(found: tuple) -> tuple:
        given.append([np.array(x) for x in found])
        places, velocities, reaction = found[0], found[1], found[-1]
        bars.extend(random.standard_normal(x.shape) for x in (places, velocities, reaction))
        return tuple(bars)

    found = predictor.transfer.gradient(*run, loss, None)
    assert len(given) == 1
    for own, expected in zip(given[0], states, strict=True):
        assert np.array_equal(own, expected)
    assert np.ptp(states[-1], axis=0).max() > 0.0
    core_bars = bars if transfer == TOTAL_LAGRANGIAN else [*bars[:2], None, bars[2]]
    for name, bar in run_core_adjoint(*run, core_bars).items():
        assert np.array_equal(found[name], bar), name
    assert np.abs(found["mu"]).max() > 0.0


@pytest.mark.parametrize("integrator", [EXPLICIT, IMPLICIT])
def test_checkpoints_leave_the_states_as_they_are(integrator: str) -> None:
    predictor, belief = scene(TOTAL_LAGRANGIAN, integrator)
    model, fields, schedule = run_of(predictor, belief)
    tight = type(model)(predictor.body.geometry, {"active": [], "law": belief.law, "memory_budget": 400_000})
    states, given = tight.simulate(fields, schedule), []

    def loss(*found: np.ndarray) -> tuple:
        given.extend(np.array(x) for x in found)
        return np.ones_like(found[0]), None

    _, recomputed = tight.gradient(fields, schedule, loss)
    assert recomputed > 0
    for own, expected in zip(given, states, strict=True):
        assert np.array_equal(own, expected)


@pytest.mark.parametrize(("transfer", "integrator"), RUNS)
def test_no_other_run_is_needed(transfer: str, integrator: str, monkeypatch: pytest.MonkeyPatch) -> None:
    predictor, belief = scene(transfer, integrator)
    expected = predictor.predict(belief)
    fresh, _ = scene(transfer, integrator)
    monkeypatch.setattr(type(fresh.transfer), "simulate", None)
    found, _ = predict_with_gradient(fresh, belief, np.ones_like, keys=[KEY], last=FRAMES)
    assert np.array_equal(found.position, expected.position)
    for own, reading in zip(found.readings, expected.readings, strict=True):
        assert np.array_equal(own.value, reading.value)


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize("error", [ZeroDivisionError, KeyboardInterrupt])
@pytest.mark.parametrize(("transfer", "integrator"), RUNS)
def test_what_a_loss_raises_comes_out(transfer: str, integrator: str, error: type, workers: int) -> None:
    predictor, belief = scene(transfer, integrator, workers)

    def loss(position: np.ndarray) -> np.ndarray:
        raise error("told by the loss")

    with pytest.raises(error, match="told by the loss"):
        predict_with_gradient(predictor, belief, loss, keys=[KEY], last=FRAMES)


@pytest.mark.parametrize(("transfer", "integrator"), RUNS)
def test_a_run_is_stopped_on_its_way_forward_too(transfer: str, integrator: str) -> None:
    predictor, belief = scene(transfer, integrator)
    model, *run = run_of(predictor, belief)
    seen: list[int] = []

    def progress(frame: int) -> bool:
        seen.append(frame)
        if len(seen) == 2:
            raise KeyboardInterrupt
        return True

    def loss(*found: np.ndarray) -> tuple:
        raise AssertionError("the run had been stopped")

    with pytest.raises(KeyboardInterrupt):
        model.gradient(*run, loss, progress)
    assert seen == [1, 2]
    seen.clear()

    def zeros(*found: np.ndarray) -> tuple:
        return (None,) * len(found)

    def count(frame: int) -> bool:
        seen.append(frame)
        return True

    model.gradient(*run, zeros, count)
    frames = list(range(1, FRAMES))
    assert seen == [*frames, *reversed(frames)]


@pytest.mark.parametrize("transfer", [TOTAL_LAGRANGIAN, MLS])
def test_bars_of_another_size_are_told(transfer: str) -> None:
    predictor, belief = scene(transfer, EXPLICIT)
    model, *run = run_of(predictor, belief)
    with pytest.raises(ValueError, match="the bar of the"):
        model.gradient(*run, lambda *found: (np.ones(3), *(None,) * (len(found) - 1)))
    with pytest.raises(ValueError, match="a trajectory's bar must be"):
        model.gradient(*run, lambda *found: ())
