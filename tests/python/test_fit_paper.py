"""The paper's schedule: windows, the states they begin from, the fit through them, resuming."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from command_example import SPACING, TRUTH, answer, call, make_capture
from mphygs.capture.format import Capture
from mphygs.commands.fit import main as fit
from mphygs.compare.noise import observe
from mphygs.fit import paper
from mphygs.fit.paper_plan import PaperStage, check_windows, paper_plan, remembers, window_frames
from mphygs.fit.problem import Problem
from mphygs.fit.window_start import start_at
from mphygs.model.belief import Belief
from mphygs.model.registry import faults
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import Settings

TRANSFERS = ("total-lagrangian", "mls")


def test_the_plan_is_the_papers_and_leaves_out_windows_longer_than_the_motion() -> None:
    names = [(s.length, s.count) for s in paper_plan(0.01, {"a": (0, 50)})]
    assert names == [(5, 3), (10, 3), (15, 3), (25, 2), (None, 1)]
    assert [s.length for s in paper_plan(0.01, {"a": (0, 12), "b": (3, 9)})] == [5, 10, None]


def test_windows_stand_one_after_the_other_from_where_motion_begins() -> None:
    stage = PaperStage("", 0.01, 5, 3, 15)
    assert window_frames(stage, (0, 50), None) == [(None, 0, 5), (5, 6, 10), (10, 11, 15)]
    # Before the release all rests; the first window sees the release itself.
    assert window_frames(stage, (2, 50), 7) == [(None, 2, 12), (12, 13, 17), (17, 18, 22)]
    # A range that begins in mid-motion does not see the start at all; what is too short is no window.
    assert window_frames(stage, (20, 26), None) == [(20, 21, 25)]
    assert window_frames(replace(stage, length=None, count=1), (4, 30), 2) == [(None, 4, 30)]
    # With all of the motion before them, the same frames count but for the one whose state would be given.
    whole = window_frames(stage, (0, 50), None, from_rest=True)
    assert whole == [(None, 0, 5), (None, 5, 10), (None, 10, 15)]
    assert [s.frames for s in paper_plan(0.01, {"a": (0, 12)}, from_rest=True)] == [5 + 10 + 12, 10 + 12, 12]


@pytest.mark.parametrize("name", [fault.name for fault in faults()])
def test_effects_that_windows_cannot_fit_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match=f"--schedule paper: the effect '{name}' .*expected --schedule fast"):
        check_windows(["viscosity", name])


def swing(transfer: str, sigma: float = 0.0) -> tuple[Capture, Belief, Predictor]:
    """A swinging bar with markers in five cross-sections, measured by its own simulation."""
    grid = [[x, y, z] for x in (0.012, 0.024, 0.036, 0.048, 0.06) for y in (0.0, 0.02) for z in (0.0, 0.02)]
    motion = np.zeros((16, 3))
    motion[:, 1] = 0.004 * np.sin(0.2 * np.arange(16)) ** 2
    capture = bar_capture(
        frames=16, fps=100.0, motion=motion, markers_at=np.array(grid), sigma=max(sigma, 1e-6)
    )
    belief = bar_belief(capture, youngs_modulus=1e5, free=("part0.youngs_modulus",))
    settings = Settings(0.01, dtype="float64", workers=2, transfer=transfer)
    recording = capture.sequence("a")
    seen = Predictor(capture, recording, settings).predict(belief).position
    seen = seen + sigma * np.random.default_rng(0).standard_normal(seen.shape)
    measured = replace(recording, markers=replace(recording.markers, position=seen))
    capture = replace(capture, sequences=(measured,))
    return capture, belief, Predictor(capture, measured, settings)


@pytest.mark.parametrize("transfer", TRANSFERS)
def test_a_start_in_mid_motion_goes_on_as_the_whole_motion_does(transfer: str) -> None:
    capture, belief, one = swing(transfer)
    whole = one.predict(belief)
    start = start_at(one, observe(one.recording, one.attachment), 6)
    went_on = one.predict(belief, last=11, start=start)
    np.testing.assert_array_equal(went_on.frames, np.arange(6, 11))
    expected = whole.position[6:11]
    assert np.abs(expected[-1] - expected[0]).max() > 3e-3, "the bar should move on"
    # Measured, from 20 markers: apart by 7 % of the largest motion at most, 17 % with MLS, whose particles
    # keep the strain that was interpolated.
    largest = np.abs(whole.position - whole.position[0]).max()
    share = 0.1 if transfer == "total-lagrangian" else 0.22
    np.testing.assert_allclose(went_on.position, expected, atol=share * largest)
    assert np.abs(went_on.position[0] - expected[0]).max() < 0.05 * largest
    assert np.abs(went_on.velocity[0] - whole.velocity[6]).max() < 0.1 * np.abs(whole.velocity).max()


@pytest.mark.parametrize("transfer", TRANSFERS)
@pytest.mark.parametrize("rest", ["stress-free", "equilibrium"])
def test_the_gradient_of_a_window_is_that_of_differences(transfer: str, rest: str) -> None:
    capture, belief, one = swing(transfer)
    if rest == "equilibrium":
        capture = replace(capture, rest=rest)
        belief = replace(belief, prestress="equilibrium")
    start = start_at(one, observe(one.recording, one.attachment), 6)
    key = "part0.youngs_modulus"
    substep = one.stable_substep(belief)
    bar = np.random.default_rng(1).standard_normal((5, *one.attachment.anchor.shape))
    run = {"keys": [key], "last": 11, "substep": substep, "start": start}
    _, gradient = predict_with_gradient(one, belief, lambda _: bar, **run)
    sides = [belief.with_parameter(key, value=1e5 * np.exp(s)) for s in (1e-4, -1e-4)]
    later, sooner = (one.predict(b, last=11, substep=substep, start=start).position for b in sides)
    expected = np.vdot(bar, later - sooner) / 2e-4
    assert gradient[0] == pytest.approx(expected, rel=1e-4)
    jacobian = one.predict(belief, last=11, keys=[key], substep=substep, start=start).jacobian[..., 0]
    assert np.vdot(bar, jacobian) == pytest.approx(expected, rel=1e-4)


def test_too_few_markers_or_all_in_a_plane_are_told() -> None:
    capture, _, one = swing("total-lagrangian")
    observation = observe(one.recording, one.attachment)
    few = observation.without(np.arange(20) > 2)
    with pytest.raises(ValueError, match="sequence 'a' shows 3 markers about frame 6; expected at least 4"):
        start_at(one, few, 6)
    free = bar_capture(held=None, markers_at=np.array([[0.01 * k, 0.01 * (k % 2), 0.0] for k in range(6)]))
    falling = Predictor(free, free.sequence("a"), Settings(0.01))
    with pytest.raises(ValueError, match="lie in one plane"):
        start_at(falling, observe(falling.recording, falling.attachment), 6)


@pytest.mark.parametrize("transfer", TRANSFERS)
def test_windows_find_youngs_modulus_from_far_off(transfer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "ITERATIONS", 25)
    capture, belief, one = swing(transfer, sigma=1e-4)
    start = belief.with_parameter("part0.youngs_modulus", value=3e4)
    observations = {"a": observe(one.recording, one.attachment)}
    told, stages = [], []
    settings = replace(one.settings, dtype="float32")
    solution = paper.fit_by_windows(
        capture, start, {"a": (0, 16)}, observations, settings, report=told.append,
        after_stage=lambda stage, found: stages.append((stage.name, found.belief.free[0].value)),
    )  # fmt: skip
    assert [name for name, _ in stages][-1] == "all frames" and len(stages) == 4
    assert stages[0][1] == pytest.approx(1e5, rel=0.1), "short windows alone find the scale"
    assert solution.belief.free[0].value == pytest.approx(1e5, rel=0.01)
    assert solution.evaluation.jacobian.any()
    assert any("3 windows of 5 frames: iteration 20 of 25" in line for line in told)


def test_what_a_window_remembers_survives() -> None:
    _, belief, plain = swing(TRANSFERS[0])
    truth = belief.with_effect("relaxation", {"ratio": 2.0, "tau": 0.03})
    shown = plain.predict(truth).position
    markers = replace(plain.recording.markers, position=shown)
    recording = replace(plain.recording, markers=markers)
    capture = replace(plain.capture, sequences=(recording,))
    one = Predictor(capture, recording, plain.settings)
    observations = {"a": observe(recording, one.attachment)}
    problem = Problem(capture, one.settings, {"a": (0, 16)}, observations, {"a": one})
    stage = PaperStage("", 0.01, 5, 3, 15)
    remembering, forgetting = (
        paper._Batch.of(problem, stage, from_rest=from_rest).measure(truth)[0] for from_rest in (True, False)
    )
    prior = 0.5 * float((problem.prior_rows(truth)[0] ** 2).sum())
    assert remembering - prior < 1e-6 * (forgetting - prior)
    # The whole schedule finds what only a motion with its past tells.
    start = truth.with_parameter("relaxation.ratio", value=0.5)
    assert remembers(start.effects) and not remembers(belief.effects)
    cost, gradient = paper._Batch.of(problem, stage, from_rest=True).measure(start)
    ratio = [p.key for p in start.free].index("relaxation.ratio")
    assert cost > 100.0 * remembering and gradient[ratio] < 0.0


def test_windows_side_by_side_take_a_core_each_and_give_them_back(monkeypatch: pytest.MonkeyPatch) -> None:
    capture, belief, one = swing(TRANSFERS[0])
    observations = {"a": observe(one.recording, one.attachment)}
    problem = Problem(capture, one.settings, {"a": (0, 16)}, observations, {"a": one})
    batch = paper._Batch.of(problem, PaperStage("", 0.01, 5, 3, 15))
    seen: list[int] = []
    through = paper.predict_with_gradient

    def counted(predictor: Predictor, *given: object, **named: object) -> object:
        seen.append(predictor.workers)
        return through(predictor, *given, **named)

    monkeypatch.setattr(paper, "predict_with_gradient", counted)
    batch.measure(belief)
    assert seen == [1, 1, 1] and one.workers == 2
    # One window has all cores to itself.
    whole = paper._Batch.of(problem, PaperStage("", 0.01, None, 1, 16))
    whole.measure(belief)
    assert seen[3:] == [2]


def test_the_command_resumes_to_the_same_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "ITERATIONS", 6)
    capture = make_capture(tmp_path / "capture", eta=0.0)
    options = ["--schedule", "paper", "--transfer", "mls", "--spacing", 2 * SPACING, "--frames", "0:9"]
    whole = answer(fit, capture, "--out", tmp_path / "whole", *options)
    assert whole["transfer"] == "mls"
    assert 0.4 < whole["parameters"]["bar.youngs_modulus"]["value"] / TRUTH["bar.youngs_modulus"] < 1.6
    real, stages = paper.adam, []

    def stopped(*arguments: object) -> object:
        stages.append(1)
        if len(stages) == 2:
            raise KeyboardInterrupt
        return real(*arguments)

    monkeypatch.setattr(paper, "adam", stopped)
    code, _, told = call(fit, capture, "--out", tmp_path / "parts", *options)
    assert code == 130 and "--resume" in told
    monkeypatch.setattr(paper, "adam", real)
    resumed = answer(fit, "--out", tmp_path / "parts", "--resume")
    assert resumed["parameters"] == whole["parameters"]
    document = json.loads((tmp_path / "parts" / "run.json").read_text())
    assert [s["name"] for s in document["history"]] == ["3 windows of 5 frames", "all frames"]


def test_options_that_do_not_go_together_are_told(tmp_path: Path) -> None:
    capture = make_capture(tmp_path / "capture")
    for options, words in (
        (["--effects", "time_offset"], "is a fault of the measurement"),
        (["--optimiser", "lbfgs"], "whose optimiser is adam"),
    ):
        code, out, err = call(fit, capture, "--schedule", "paper", "--out", tmp_path / "run", *options)
        assert (code, out) == (2, "") and err.count("\n") == 1 and words in err
