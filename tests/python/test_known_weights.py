"""Known loads that are weights: their mass is inertia alone, in the sequences that have the load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.capture.format import Capture
from mphygs.capture.holds import Load
from mphygs.diagnose.effect_variants import hanging_mass_label
from mphygs.diagnose.finite_trials import hanging_mass_trials
from mphygs.fit.belief_document import belief_from_document, document_of_belief
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import covariance, minimise
from mphygs.fit.placement import masses_of_loads, with_placed_effect
from mphygs.model.belief import Belief
from mphygs.model.registry import effect
from mphygs.simulate.prediction import Predictor, Settings
from mphygs.simulate.scope import belief_of_sequence, in_scope, is_absent, stated_weights

SIGMA = 1e-4  # [m]
MASS = 4e-3  # [kg]
TIP = np.array([[0.05, 0.0, 0.0], [0.06, 0.02, 0.02]])
HUNG = Load(TIP, np.array([0.0, 0.0, -9.81 * MASS]), 0)
SPACING = 0.01


def two_recordings(*, frames: int = 16, rest: str = "equilibrium", load: Load = HUNG) -> Capture:
    """A clamped bar, shaken: `a` without a load, `b` with one at the tip."""
    shake = 0.005 * np.sin(np.linspace(0.0, 6.0, frames))[:, None] * [0.3, 1.0, 0.0]
    capture = bar_capture(frames=frames, fps=50.0, rest=rest, motion=shake, sigma=SIGMA, fit=(0, frames))
    plain = capture.sequence("a")
    return replace(capture, sequences=(plain, replace(plain, name="b", loads=(load,))))


def stiff_bar(capture: Capture, **changes: object) -> Belief:
    prestress = "equilibrium" if capture.rest == "equilibrium" else "off"
    return bar_belief(capture, youngs_modulus=1e5, prestress=prestress, **changes)


def with_weight(belief: Belief, capture: Capture, mass: float) -> Belief:
    return belief.with_effect("attached_mass", {"m": mass}, masses_of_loads(capture, ["a", "b"])[0])


def simulated(capture: Capture, belief: Belief, name: str, transfer: str = "total-lagrangian") -> np.ndarray:
    settings = Settings(SPACING, workers=1, dtype="float64", transfer=transfer)
    return Predictor(capture, capture.sequence(name), settings).predict(belief, substep=2e-4).position


# ---- where the masses stand ---------------------------------------------------------------------
def test_one_mass_for_alike_loads_of_several_sequences() -> None:
    capture = two_recordings()
    plain, hung = capture.sequences
    other = Load(TIP - [0.02, 0, 0], np.array([0.0, 0.0, -0.02]), 3)
    twice = replace(hung, name="c", loads=(HUNG, replace(HUNG, start_frame=4), other))
    capture = replace(capture, sequences=(plain, hung, twice))
    first, second = masses_of_loads(capture, ["a", "b", "c"])
    assert first["sequences"] == ["b", "c"] and second["sequences"] == ["c"]
    np.testing.assert_allclose(first["place"], [0.055, 0.01, 0.01])
    np.testing.assert_allclose(second["place"], [0.035, 0.01, 0.01])
    assert all(s["weight"] is False and s["at_rest"] is False for s in (first, second))
    assert masses_of_loads(capture, ["a"]) == []
    assert hanging_mass_label(effect("attached_mass"), first) == "attached_mass, the load of b, c"


def test_a_box_wider_than_the_object_counts_as_far_as_the_object_goes() -> None:
    wide = replace(HUNG, box=np.array([[0.05, -1.0, -1.0], [1.0, 1.0, 1.0]]))
    capture = two_recordings(load=wide)
    np.testing.assert_allclose(masses_of_loads(capture, ["b"])[0]["place"], [0.055, 0.01, 0.01])


def test_trials_weigh_what_the_load_weighs() -> None:
    capture = two_recordings()
    # Another load in the same box: each trial has its own load's mass.
    light = replace(HUNG, force=np.array([0.0, 0.0, -9.81e-3]))
    plain, hung = capture.sequences
    capture = replace(capture, sequences=(plain, replace(hung, loads=(HUNG, light))))
    belief = stiff_bar(capture)
    trials = hanging_mass_trials(effect("attached_mass"), capture, belief, ["a", "b"])
    masses = [t.belief["attached_mass.m"].value for t in trials]
    np.testing.assert_allclose(masses, [0.5 * MASS, MASS, 0.5e-3, 1e-3])
    for trial in trials:
        assert (trial.effect, trial.label) == ("attached_mass", "attached_mass, the load of b")
        assert stated_weights(trial.belief) == ("attached_mass",)
    assert hanging_mass_trials(effect("attached_mass"), capture, belief, ["a"]) == []
    assert (
        hanging_mass_trials(effect("attached_mass"), capture, replace(belief, gravity=np.zeros(3)), ["b"])
        == []
    )


def test_a_named_mass_is_that_of_the_load_where_there_is_one() -> None:
    capture = two_recordings()
    belief = with_placed_effect(stiff_bar(capture), "attached_mass", capture, ["a", "b"])
    assert belief.term("attached_mass").settings == masses_of_loads(capture, ["a", "b"])[0]
    free = with_placed_effect(stiff_bar(capture), "attached_mass", capture, ["a"])
    assert set(free.term("attached_mass").settings) == {"place"}
    assert stated_weights(free) == ()


# ---- scope ------------------------------------------------------------------------------------
def test_a_sequence_without_the_load_has_the_mass_at_its_null() -> None:
    capture = two_recordings()
    belief = with_weight(stiff_bar(capture), capture, MASS)
    assert (in_scope(belief, "attached_mass", "a"), in_scope(belief, "attached_mass", "b")) == (False, True)
    assert belief_of_sequence(belief, "b") is belief
    absent = belief_of_sequence(belief, "a")
    assert absent["attached_mass.m"].value == 0.0
    changed = {p.key for p in belief.parameters if absent[p.key] != p}
    assert changed == {"attached_mass.m"}
    parameter = belief["attached_mass.m"]
    assert is_absent(belief, parameter, "a") and not is_absent(belief, parameter, "b")
    assert not is_absent(belief, belief["part0.density"], "a")


def test_a_mass_fitted_in_its_logarithm_can_be_absent_as_well() -> None:
    capture = two_recordings()
    belief = with_weight(stiff_bar(capture), capture, MASS)
    belief = belief.with_parameter("attached_mass.m", log=True, lower=1e-6)
    assert belief_of_sequence(belief, "a")["attached_mass.m"].value == 0.0


def test_a_belief_kept_and_read_has_its_scope() -> None:
    capture = two_recordings()
    belief = with_weight(stiff_bar(capture), capture, MASS)
    again = belief_from_document(document_of_belief(belief))
    assert not in_scope(again, "attached_mass", "a") and stated_weights(again) == ("attached_mass",)


@pytest.mark.parametrize("transfer", ["total-lagrangian", "mls"])
def test_nothing_changes_in_a_sequence_without_the_load(transfer: str) -> None:
    capture = two_recordings(rest="stress-free", frames=8)
    plain = stiff_bar(capture)
    heavy = with_weight(plain, capture, MASS)
    for name, same in (("a", True), ("b", False)):
        without, having = (simulated(capture, b, name, transfer) for b in (plain, heavy))
        assert bool(np.abs(having - without).max() < 1e-12) is same
    settings = Settings(SPACING, workers=1, dtype="float64", transfer=transfer)
    found = Predictor(capture, capture.sequence("a"), settings).predict(heavy, keys=["attached_mass.m"])
    assert not np.any(found.jacobian)


def test_a_sequence_without_the_load_takes_the_substep_of_the_object_alone() -> None:
    # Nearly all of the bar's nodes share in the mass: with it they swing more slowly, and steps are longer.
    capture = two_recordings(rest="stress-free", frames=8)
    plain = stiff_bar(capture)
    heavy = with_weight(plain, capture, 10.0)
    steps = {}
    for name in ("a", "b"):
        predictor = Predictor(capture, capture.sequence(name), Settings(0.04, workers=1, dtype="float64"))
        steps[name] = predictor.stable_substep(heavy) / predictor.stable_substep(plain)
    assert steps["a"] == pytest.approx(1.0, rel=1e-6) and steps["b"] > 1.1


# ---- the weight is not added again ------------------------------------------------------------
@pytest.mark.parametrize("prestress", ["paper", "equilibrium"])
@pytest.mark.parametrize("place", [[0.055, 0.01, 0.01], [0.06, 0.0, 0.0], [0.043, 0.017, 0.004]])
def test_a_mass_whose_weight_is_stated_moves_nothing_at_rest(prestress: str, place: list[float]) -> None:
    # No load acts yet: the mass is inertia alone, and nothing that rests begins to move.
    rest = "equilibrium" if prestress == "equilibrium" else "stress-free"
    capture = bar_capture(frames=6, fps=25.0, rest=rest)
    settings = Settings(SPACING, workers=1, dtype="float64")
    predictor = Predictor(capture, capture.sequence("a"), settings)
    moved = []
    for weight in (False, True):
        belief = bar_belief(capture, youngs_modulus=1e5, prestress=prestress)
        constants = {"place": place, "sequences": ["a"], "weight": weight, "at_rest": False}
        belief = belief.with_effect("attached_mass", {"m": 8e-3}, constants)
        moved.append(np.abs(predictor.predict(belief).position - predictor.recording.markers.at).max())
    assert moved[0] < 1e-6
    if prestress == "equilibrium":
        assert moved[1] > 1e-4


@pytest.mark.parametrize("transfer", ["total-lagrangian", "mls"])
def test_what_hangs_at_rest_hangs_as_low_whatever_its_mass(transfer: str) -> None:
    capture = two_recordings()
    frames = 16
    still = replace(capture.sequence("b"), held=bar_capture().sequence("a").held, fps=20.0)
    capture = replace(capture, sequences=(capture.sequence("a"), still))
    plain = stiff_bar(capture).with_effect("mass_damping", {"alpha": 60.0})
    settings = Settings(SPACING, workers=1, dtype="float64", transfer=transfer)
    predictor = Predictor(capture, still, settings)
    sag = []
    for mass in (0.0, 1e-3, MASS):
        position = predictor.predict(with_weight(plain, capture, mass)).position
        assert len(position) == frames and np.abs(position[-1] - position[-2]).max() < 1e-6
        sag.append(position[-1] - still.markers.at)
    assert np.abs(sag[0][:, 2]).max() > 1e-3
    for other in sag[1:]:
        np.testing.assert_allclose(other, sag[0], atol=2e-3 * np.abs(sag[0]).max())


# ---- derivatives, recovery --------------------------------------------------------------------
@pytest.mark.parametrize("transfer", ["total-lagrangian", "mls"])
@pytest.mark.parametrize("mass", [0.0, MASS])
def test_tangent_by_the_mass_is_the_difference(transfer: str, mass: float) -> None:
    capture = two_recordings(frames=8)
    belief = with_weight(stiff_bar(capture), capture, mass)
    settings = Settings(SPACING, workers=1, dtype="float64", transfer=transfer)
    predictor = Predictor(capture, capture.sequence("b"), settings)
    parameter, step = belief["attached_mass.m"], 1e-6
    found = predictor.predict(belief, keys=[parameter.key], substep=2e-4).jacobian[..., 0] / parameter.slope
    sides = [
        predictor.predict(
            belief.with_parameter(parameter.key, lower=-1.0, value=mass + side * step), substep=2e-4
        ).position
        for side in (1.0, -1.0)
    ]
    expected = (sides[0] - sides[1]) / (2.0 * step)
    assert np.abs(expected).max() > 0.1
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def hanging_capture(truth: Belief, capture: Capture) -> Capture:
    """The two recordings with markers simulated at the truth, noise added."""
    noise = np.random.default_rng(3)
    recordings = []
    for recording in capture.sequences:
        position = simulated(capture, truth, recording.name)
        position = position + SIGMA * noise.standard_normal(position.shape)
        recordings.append(replace(recording, markers=replace(recording.markers, position=position)))
    return replace(capture, sequences=tuple(recordings), folder=Path("."))


def test_the_mass_of_a_hanging_weight_is_found_from_two_recordings() -> None:
    capture = two_recordings()
    free = ("part0.youngs_modulus",)
    truth = with_weight(stiff_bar(capture, free=free), capture, MASS)
    measured = hanging_capture(truth, capture)
    experiment = Experiment.of(measured, Settings(SPACING, workers=1))
    problem = experiment.problem(SPACING)
    start = with_weight(stiff_bar(capture, free=free), measured, 0.0)
    start = start.with_parameter("part0.youngs_modulus", value=1.2e5)
    solution = minimise(problem, start)
    errors = np.sqrt(np.diag(covariance(solution.evaluation)))
    for parameter, error in zip(solution.belief.free, errors, strict=True):
        wanted = truth[parameter.key]
        assert abs(parameter.coordinate - wanted.coordinate) < 3.0 * error, parameter.key
    assert solution.belief["attached_mass.m"].value == pytest.approx(MASS, rel=0.1)
    # Without its inertia the hanging recording is not explained, the other one is.
    bare = minimise(problem, stiff_bar(capture, free=free)).evaluation
    rms = {name: np.sqrt(np.mean(bare.residual[rows] ** 2)) for name, rows in bare.rows.items()}
    found = solution.evaluation
    assert np.sqrt(found.chi_square / found.data_rows) < 1.1 < 2.0 < rms["b"]
