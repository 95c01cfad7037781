"""Implicit steps through the predictor, the torch operation and the commands."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.autograd import gradcheck

from bar_capture import bar_belief, bar_capture
from command_example import answer, call
from mphygs.capture.format import Capture, Known, Markers, save_capture
from mphygs.commands.compare import main as compare
from mphygs.commands.diagnose import main as diagnose
from mphygs.commands.fit import main as fit
from mphygs.commands.predict import main as predict
from mphygs.fit.run import load_run
from mphygs.fit.start import starting_belief
from mphygs.model import registry, user_effect
from mphygs.model.descriptor import ParameterSpec
from mphygs.model.user_effect import UserEffect
from mphygs.simulate.op import rollout
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import AUTO, EXPLICIT, IMPLICIT, MLS, Settings
from mphygs.simulate.step_choice import FEWEST, steps_a_frame
from test_simulate_op import all_fields, scene

pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")

FRAMES, FPS, SIGMA = 36, 60.0, 1e-4
STIFF = 5e8
# Frames of what is fitted: as few as ask for more steps a frame than the fewest.
FITTED = 27


def stem(frames: int = FRAMES) -> Capture:
    """A stem of 8 x 8 x 400 mm on a hold that is shaken across it."""
    times = np.arange(frames) / FPS
    motion = np.zeros((frames, 3))
    motion[:, 1] = 0.01 * np.sin(2 * np.pi * 3.0 * times) * np.minimum(times / 0.15, 1.0)
    shares = np.array([[s, a, b] for s in (0.25, 0.5, 0.75, 1.0) for a, b in ((0.5, 0.5), (1.0, 0.0))])
    return bar_capture(
        lengths=(0.4,), side=0.008, held=0.008, frames=frames, fps=FPS, motion=motion,
        known=Known(density={"part0": 800.0}, poissons_ratio=0.3), markers_at=shares * [0.4, 0.008, 0.008],
        fit=(0, 24), sigma=SIGMA, gravity=np.zeros(3),
    )  # fmt: skip


def settings(integrator: str, **more: object) -> Settings:
    return Settings(0.008, workers=1, integrator=integrator, **more)


def predicted(integrator: str, youngs_modulus: float, frames: int = FRAMES, **more: object) -> np.ndarray:
    capture = stem(frames)
    predictor = Predictor(capture, capture.sequence("a"), settings(integrator, **more))
    belief = bar_belief(capture, youngs_modulus=youngs_modulus, density=800.0)
    return predictor.predict(belief).position


def test_implicit_steps_follow_explicit_ones() -> None:
    explicit = predicted(EXPLICIT, 1e7, 20, dtype="float64")
    implicit = predicted(IMPLICIT, 1e7, 20, dtype="float64")
    assert np.abs(explicit - explicit[0]).max() > 0.005
    assert np.sqrt(np.mean((implicit - explicit) ** 2)) < 1e-4
    assert np.abs(implicit - explicit).max() > 0.0


def test_implicit_steps_are_in_double_precision_whatever_the_settings_say() -> None:
    single, double = (predicted(IMPLICIT, STIFF, 20, dtype=t) for t in ("float32", "float64"))
    assert (single == double).all()


def test_slopes_are_those_of_differences() -> None:
    capture = stem(16)
    predictor = Predictor(capture, capture.sequence("a"), settings(IMPLICIT, dtype="float64"))
    belief = bar_belief(capture, youngs_modulus=STIFF, density=800.0, free=("part0.youngs_modulus",))
    found = predictor.predict(belief, keys=("part0.youngs_modulus",)).jacobian[..., 0]
    (at,) = belief.coordinates
    up, down = (predictor.predict(belief.at(np.array([at + s * 1e-4]))).position for s in (1, -1))
    difference = (up - down) / 2e-4
    assert np.abs(difference).max() > 1e-5
    assert np.abs(found - difference).max() < 1e-5 * np.abs(difference).max()


@pytest.mark.parametrize(("youngs_modulus", "shift"), [(3e3, -1e-6), (1e5, -3e-4)])
def test_slopes_are_found_where_a_release_leaves_a_moment_and_next_to_no_strain(
    youngs_modulus: float, shift: float
) -> None:
    capture = bar_capture(lengths=(0.04, 0.04), frames=5, fps=60.0)
    capture = replace(capture, sequences=(replace(capture.sequences[0], release=2),))
    predictor = Predictor(capture, capture.sequence("a"), settings(IMPLICIT))
    keys = ("part0.youngs_modulus", "part1.youngs_modulus")
    belief = starting_belief(capture).with_parameter("a.release_shift", value=shift)
    for key in keys:
        belief = belief.with_parameter(key, value=youngs_modulus)
    free = [p.key for p in belief.free]
    found = predictor.predict(belief, keys=free).jacobian
    gradient = predict_with_gradient(predictor, belief, np.ones_like, keys=keys, last=5)[1]
    for number, key in enumerate(keys):
        step = 1e-4 * (np.array(free) == key)
        up, down = (predictor.predict(belief.at(belief.coordinates + s * step)).position for s in (1, -1))
        difference = (up - down) / 2e-4
        own = found[..., free.index(key)]
        assert np.abs(difference).max() > 1e-6
        assert np.abs(own - difference).max() < 1e-5 * np.abs(difference).max()
        assert gradient[number] == pytest.approx(own.sum(), rel=1e-7)


class Braked(UserEffect):
    """A drag that only double precision beside double precision can evaluate."""

    name = "braked"
    parameters = (ParameterSpec("beta", "1/s", 0.0, 0.0, 100.0, 1.0),)

    def force(self, state, parameters):
        there = torch.einsum("ni,ij->nj", state.velocity, torch.eye(3, dtype=state.mass.dtype))
        return -parameters["beta"] * state.mass[:, None] * there


def test_effects_in_python_have_the_precision_of_the_steps_that_auto_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(registry, "_USER", {})
    monkeypatch.setattr(user_effect, "_IMPLEMENTATIONS", {})
    user_effect.register_effect(Braked)
    capture = stem(6)
    found = []
    for integrator in (AUTO, IMPLICIT, EXPLICIT):
        predictor = Predictor(capture, capture.sequence("a"), settings(integrator))
        belief = bar_belief(capture, youngs_modulus=STIFF, density=800.0).with_effect("braked", {"beta": 3.0})
        if integrator != EXPLICIT:
            found.append(predictor.predict(belief).position)
        soft = bar_belief(capture, youngs_modulus=1e5, density=800.0).with_effect("braked", {"beta": 3.0})
        if integrator != IMPLICIT:
            found.append(predictor.predict(soft, last=3).position)
    auto, auto_soft, implicit, explicit_soft = found
    assert (auto == implicit).all() and (auto_soft == explicit_soft).all()


def test_the_operation_passes_gradcheck() -> None:
    belief, body, model = scene()
    fields = all_fields(belief, body, model)
    schedule = {"steps": np.array([7, 5], np.int32), "dt": np.array([4e-4, 5e-4]), "start": 0.01}
    schedule["implicit"] = True
    names = ("mu", "mass", "gravity", "velocity0", "effect")
    inputs = tuple(fields[name].clone().requires_grad_() for name in names)

    def motion(*given: torch.Tensor) -> torch.Tensor:
        states = rollout(model, fields | dict(zip(names, given, strict=True)), schedule)
        weights = torch.linspace(0.5, 1.5, states[0].numel(), dtype=torch.float64)
        return torch.stack([(s.reshape(-1) * weights).sum() for s in states])

    assert gradcheck(motion, inputs, eps=1e-5, atol=1e-5, rtol=1e-3, fast_mode=True)


def test_auto_takes_implicit_steps_where_the_object_is_stiff_only() -> None:
    capture = stem()
    predictor = Predictor(capture, capture.sequence("a"), settings(AUTO))
    soft, stiff = (bar_belief(capture, youngs_modulus=e, density=800.0) for e in (1e5, STIFF))
    assert not predictor.implicit(soft) and predictor.implicit(stiff)
    assert predictor.stable_substep(stiff) == pytest.approx(1 / (FEWEST * FPS))
    explicit = Predictor(capture, capture.sequence("a"), settings(EXPLICIT))
    assert predictor.stable_substep(soft) == explicit.stable_substep(soft)
    few = [p.predict(soft, last=6).position for p in (predictor, explicit)]
    assert (few[0] == few[1]).all()


def test_auto_changes_over_where_an_implicit_step_costs_as_much_as_the_explicit_ones_in_it() -> None:
    cost = []
    for side in (0.008, 0.032):  # one cell and four
        capture = bar_capture(lengths=(0.2,), side=side, held=0.008, frames=6, fps=FPS)
        predictor = Predictor(capture, capture.sequence("a"), settings(AUTO))
        explicit = Predictor(capture, capture.sequence("a"), settings(EXPLICIT))
        cost.append(predictor.transfer.implicit_cost)
        substep = explicit.stable_substep(bar_belief(capture, youngs_modulus=1e6, density=800.0))
        step = 1.0 / (predictor.steps_a_frame * FPS)
        even = 1e6 * (cost[-1] * substep / step) ** 2  # substeps fall with the modulus's root
        for share, implicit in ((0.98, False), (1.02, True)):
            belief = bar_belief(capture, youngs_modulus=share * even, density=800.0)
            assert predictor.implicit(belief) == implicit
    assert 50 < cost[0] < 1.2 * cost[0] < cost[1] < 500


def test_an_implicit_step_with_mls_is_refused_in_one_line() -> None:
    capture = stem()
    with pytest.raises(ValueError, match="not with --transfer mls; expected --transfer total-lagrangian"):
        Predictor(capture, capture.sequence("a"), settings(IMPLICIT, transfer=MLS))


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = tmp_path_factory.mktemp("stiff")
    capture = stem(FITTED)
    belief = bar_belief(capture, youngs_modulus=STIFF, density=800.0)
    predictor = Predictor(capture, capture.sequence("a"), settings(IMPLICIT))
    predictor.steps_a_frame = 4 * FEWEST  # the truth in steps a quarter as long
    truth = predictor.predict(belief).position
    seen = truth + SIGMA * np.random.default_rng(3).standard_normal(truth.shape)
    one = capture.sequences[0]
    assert one.markers is not None
    markers = Markers(seen, one.markers.at, SIGMA)
    recording = replace(one, markers=markers, fit=(0, 16), predict=(16, FITTED))
    save_capture(replace(capture, sequences=(recording,)), folder / "capture")
    options = ("--out", folder / "run", "--integrator", "implicit", "--spacing", 0.008, "--preset", "stem")
    given = answer(fit, folder / "capture", *options)
    steps = steps_a_frame(recording)
    assert steps > FEWEST
    return {"folder": folder, "run": folder / "run", "answer": given, "steps": steps}


def test_fit_finds_the_modulus_of_a_stiff_stem(fitted: dict) -> None:
    given = fitted["answer"]
    found = given["parameters"]["part0.youngs_modulus"]
    assert found["value"] / STIFF == pytest.approx(1.0, abs=0.03)
    assert given["integrator"] == {"a": "implicit"}
    assert given["substep"]["a"] == pytest.approx(1 / (fitted["steps"] * FPS))
    assert json.loads((fitted["run"] / "run.json").read_text())["settings"]["integrator"] == "implicit"


@pytest.mark.slow
def test_the_commands_go_on_with_implicit_steps(fitted: dict) -> None:
    before = fitted["answer"]["sequences"]["a"]["predict"]["rms"]
    assert before < 1.2 * SIGMA * np.sqrt(3.0)  # of all three components
    predicted_again = answer(predict, fitted["run"])["sequences"]["a"]
    assert predicted_again["substeps"] == fitted["steps"] * (FITTED - 1)
    compared = answer(compare, fitted["run"])["sequences"]["a"]
    assert compared["predict"]["rms"] == pytest.approx(before, rel=1e-3)
    assert answer(diagnose, fitted["run"], "--effects", "mass_damping")["ranking"]


def test_a_run_without_the_key_is_explicit(fitted: dict, tmp_path: Path) -> None:
    document = json.loads((fitted["run"] / "run.json").read_text())
    del document["settings"]["integrator"]
    for name in fitted["run"].iterdir():
        if name.is_file():
            (tmp_path / name.name).write_bytes(name.read_bytes())
    (tmp_path / "run.json").write_text(json.dumps(document))
    assert load_run(tmp_path).settings.integrator == EXPLICIT


def test_an_integrator_that_cannot_be_is_told(fitted: dict) -> None:
    code, _, error = call(fit, fitted["folder"] / "capture", "--transfer", "mls", "--integrator", "implicit")
    assert code == 2 and error.strip().count("\n") == 0 and "implicit" in error
