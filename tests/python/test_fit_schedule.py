"""The order of a fit."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import recorded
from mphygs.commands import discover as discover_command
from mphygs.commands.console import Console
from mphygs.fit import checkpointed, levenberg_marquardt, schedule, spacings, stiffness_scale
from mphygs.fit.checkpointed import fit_run
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.run import Run, StageRecord, load_run
from mphygs.fit.schedule import SCREENING_ACCURACY, TRACTABLE, ScheduleStage, fit_belief, plan_of
from mphygs.fit.spacings import deciding_spacing, screening_spacing
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Settings

FREE = ("part0.youngs_modulus",)


@dataclass
class Known:
    """A problem whose misfit is known."""

    misfit: float

    def evaluate(self, _belief: Belief, *, jacobian: bool) -> SimpleNamespace:
        assert not jacobian
        return SimpleNamespace(misfit=self.misfit)

    def narrowed(self, share: float) -> float:
        return share


@pytest.mark.parametrize(
    ("here", "there", "lost"),
    [
        (10.0, 1.2, True),
        # as far off on the grid before: the model lacks something
        (10.0, 6.0, False),
        # near enough for all frames at once
        (1.9, 0.5, False),
    ],
)
def test_a_model_that_is_lost_on_a_finer_grid_is_brought_onward(
    here: float, there: float, lost: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    start, found = object(), object()

    def minimise(share: float, belief: object, **_: object) -> SimpleNamespace:
        asked.append(share)
        assert belief is (start if share == 0.25 else found)
        return SimpleNamespace(belief=found)

    monkeypatch.setattr(schedule, "minimise", minimise)
    after = schedule._brought_onward(Known(here), start, there, None)
    assert (after is found) is lost and asked == ([0.25, 0.5] if lost else [])

    def unstable(*_: object, **__: object) -> None:
        raise SimulationError("unstable")

    monkeypatch.setattr(schedule, "minimise", unstable)
    assert schedule._brought_onward(Known(here), start, there, None) is start


def test_a_hopeless_fit_is_resumed_to_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a stage leaves far too much, the next begins from the one before it; resumed, it does so too."""
    bounds: list[tuple[float, tuple[int, float] | None]] = []

    def minimise(
        *args: object, gross: float, dwell: tuple[int, float] | None, **options: object
    ) -> Solution:
        bounds.append((gross, dwell))
        return levenberg_marquardt.minimise(*args, gross=gross, dwell=dwell, **options)

    monkeypatch.setattr(schedule, "minimise", minimise)
    capture = bar_capture(frames=30, fps=60.0, fit=(0, 30))
    truth = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    tilted = truth.with_effect("gravity", {"delta_g_z": -2.0})
    capture = recorded(capture, tilted, 0.008)
    experiment = Experiment.of(capture, Settings(0.008, workers=1))
    start = experiment.starting(truth)
    kept: list[Run] = []

    class Keeping(Run):
        def save(self) -> None:
            kept.append(self)

    run = Keeping(
        folder=tmp_path, options={}, seed=0, capture=tmp_path, digest="0" * 64, settings=experiment.settings,
        ranges=experiment.fitted, start=start, belief=start,
    )  # fmt: skip
    whole = fit_run(run, experiment)
    assert len(whole.history) >= 3 and kept[-2].history[-1].misfit > schedule.HOPELESS
    # It is not dwelt on, unless it was the grid before that could not carry the model.
    dwell = schedule.HOPELESS_ITERATIONS, schedule.HOPELESS
    assert bounds[0] == (np.inf, None) and bounds[-1] == (np.inf, dwell)
    # It matters from where the last stage begins: without what came before it ends elsewhere.
    before_last = kept[-2]
    Run.save(before_last)
    resumed = fit_run(load_run(tmp_path), experiment)
    assert resumed.belief[FREE[0]].value == whole.belief[FREE[0]].value
    assert resumed.history[-1].costs == whole.history[-1].costs
    elsewhere = fit_run(replace(before_last, earlier=None), experiment)
    assert elsewhere.history[-1].costs != whole.history[-1].costs


def test_a_fit_is_brought_onward_on_the_finer_grid_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = bar_capture(frames=20, fps=100.0, fit=(0, 20))
    truth = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    capture = recorded(capture, truth, 0.008)
    settings = Settings(0.008, workers=1)
    experiment = Experiment.of(capture, settings)
    experiment.problem(0.008)
    plan = (ScheduleStage("coarse", 0.012, 1.0, 2, 1e-3), ScheduleStage("fine", 0.008, 1.0, 3, 1e-4))
    # Every model counts as lost: where that is asked is what is looked at.
    monkeypatch.setattr(schedule, "LOST", 0.0)
    monkeypatch.setattr(schedule, "LOST_FROM", 0.0)
    lines: list[str] = []
    start = truth.with_parameter(FREE[0], value=9e4)
    solution, _ = fit_belief(
        capture, start, experiment.fitted, experiment.observations, settings, warm=True,
        plan=plan, report=lines.append,
    )  # fmt: skip
    begun = [line.split(" (")[0] for line in lines if "iteration 0" in line]
    assert begun == ["coarse", "fine", "fine", "fine"]  # two stretches, then all frames
    assert solution.belief[FREE[0]].value == pytest.approx(6e4, rel=0.02)


def test_a_fit_ends_at_what_is_lower_along_its_valley(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = bar_capture(frames=20, fps=100.0, fit=(0, 20))
    truth = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    capture = recorded(capture, truth, 0.008)
    settings = Settings(0.008, workers=1)
    experiment = Experiment.of(capture, settings)
    experiment.problem(0.008)
    start = truth.with_parameter(FREE[0], value=6.1e4)
    monkeypatch.setattr(schedule, "lower_along", lambda _problem, _found: [truth])
    ends = []
    for plan in (
        (ScheduleStage("fine", 0.008, 1.0, 0, 1.0),),
        (ScheduleStage("coarse", 0.008, 1.0, 0, 1.0),) * 2,
    ):
        solution, _ = fit_belief(
            capture, start, experiment.fitted, experiment.observations, settings, warm=True, plan=plan
        )
        ends.append(solution.belief[FREE[0]].value)
    assert ends == pytest.approx([6e4, 6e4], rel=2e-3)


def test_a_part_of_stone_among_others_is_as_stiff_as_they_are() -> None:
    capture = bar_capture(lengths=(0.02, 0.02, 0.02))

    def moduli(*values: float) -> Belief:
        free = tuple(f"part{k}.youngs_modulus" for k in range(3))
        belief = bar_belief(capture, youngs_modulus=1e5, free=free)
        for k, value in enumerate(values):
            belief = belief.with_parameter(f"part{k}.youngs_modulus", value=value)
        return belief

    found = stiffness_scale.without_stiffest(moduli(4e4, 9e5, 1e5))
    assert found is not None
    values = [found[f"part{k}.youngs_modulus"].value for k in range(3)]
    assert values == pytest.approx([4e4, (4e4 * 1e5) ** 0.5, 1e5])
    # Less than twice the next, and a light part that is soft, in which waves are as fast.
    assert stiffness_scale.without_stiffest(moduli(4e4, 1.9e5, 1e5)) is None
    light = moduli(4e4, 3e5, 1e5).with_parameter("part2.density", value=10.0)
    assert stiffness_scale.without_stiffest(light) is None
    held = moduli(4e4, 9e5, 1e5)
    fixed = tuple(replace(p, free=p.free and p.key != "part1.youngs_modulus") for p in held.parameters)
    assert stiffness_scale.without_stiffest(replace(held, parameters=fixed)) is None


def test_the_plan_of_a_screening_fit_dwells_on_nothing_gross() -> None:
    capture = bar_capture(frames=10, fps=100.0)
    coarse, deciding = screening_spacing(capture), deciding_spacing(capture)
    usual = plan_of(capture, coarse, warm=False)
    screened = plan_of(capture, coarse, warm=False, screening=True)
    assert {stage.gross for stage in usual} == {np.inf}
    assert {stage.gross for stage in screened} == {TRACTABLE}
    assert [s.accuracy for s in screened] == [max(s.accuracy, SCREENING_ACCURACY) for s in usual]
    # What is decided on is fitted as ever.
    assert plan_of(capture, deciding, warm=True, screening=True) == plan_of(capture, deciding, warm=True)


def test_a_fit_to_tracks_ends_where_an_iteration_brings_little(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = bar_capture(frames=10, fps=60.0, fit=(0, 10))
    belief = bar_belief(capture, free=FREE)
    capture = recorded(capture, belief, 0.01)
    (recording,) = capture.sequences
    noise = np.full(len(recording.markers.at), recording.markers.sigma)
    markers = replace(recording.markers, spread=noise, memory=0.9)
    tracked = replace(capture, sequences=(replace(recording, markers=markers),))
    least = {n: {s.least for s in plan_of(c, 0.01, warm=False)} for n, c in (("t", tracked), ("m", capture))}
    assert least == {"t": {schedule.TRACKED_LEAST}, "m": {0.0}}
    asked: list[float] = []
    minimise = schedule.minimise

    def counted(*args: object, least: float, **options: object) -> object:
        asked.append(least)
        return minimise(*args, **options)

    monkeypatch.setattr(schedule, "minimise", counted)
    experiment = Experiment.of(tracked, Settings(0.01, workers=1))
    experiment.problem(0.01)
    schedule.fit_belief(
        tracked, belief, experiment.fitted, experiment.observations, experiment.settings, warm=True
    )
    assert asked == [schedule.TRACKED_LEAST]


@pytest.mark.parametrize("screening", [False, True])
def test_a_run_is_fitted_by_the_plan_that_it_is_for(
    screening: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    capture = bar_capture(frames=10, fps=60.0, fit=(0, 10))
    belief = bar_belief(capture, free=FREE)
    capture = recorded(capture, belief, 0.01)
    coarse = screening_spacing(capture)
    experiment = Experiment.of(capture, Settings(coarse, workers=1))
    asked: list[tuple[ScheduleStage, ...]] = []
    monkeypatch.setattr(checkpointed, "fit_belief", lambda *_a, plan, **_k: asked.append(plan))
    run = Run(
        folder=tmp_path, options={}, seed=0, capture=tmp_path, digest="0" * 64, settings=experiment.settings,
        ranges=experiment.fitted, start=belief, belief=belief,
    )  # fmt: skip
    fit_run(run, experiment, screening=screening)
    assert asked == [plan_of(capture, coarse, warm=False, screening=screening)]


@pytest.mark.parametrize("spacing", [None, 0.01])
def test_the_loop_asks_for_a_screening_fit_unless_the_grid_is_chosen(
    spacing: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[bool] = []

    def fitted(*_: object, screening: bool, **__: object) -> None:
        asked.append(screening)
        raise SimulationError("far enough")

    monkeypatch.setattr(discover_command, "fitted", fitted)
    monkeypatch.setattr(discover_command, "load_capture", lambda _path: bar_capture(frames=10))
    options = discover_command.DiscoverOptions(capture=tmp_path, out=tmp_path / "run", spacing=spacing)
    with pytest.raises(SimulationError):
        discover_command.discover_command(options, Console(io.StringIO()))
    assert asked == [spacing is None]


@pytest.mark.parametrize(
    ("quarter", "spacings", "passed"),
    [
        (1.2, (0.01, 0.01, 0.01), True),
        # what shows in the first quarter is to be looked for there
        (1.3, (0.01, 0.01, 0.01), False),
        # on two grids all of the motion comes before the last stage
        (1.2, (0.015, 0.015, 0.015, 0.01), False),
    ],
)
def test_a_window_was_passed_where_nothing_was_off_before_it(
    quarter: float, spacings: tuple[float, ...], passed: bool
) -> None:
    misfits = (quarter, 1.2, 9.0, 9.0)
    history = tuple(
        StageRecord("", spacing, (), True, "", 1.0, misfit)
        for spacing, misfit in zip(spacings, misfits, strict=False)
    )
    half = bar_belief(bar_capture())
    state = SimpleNamespace(history=history, earlier=half, settings=Settings(0.01))
    assert (discover_command._halfway(state) is half) is passed


@pytest.mark.parametrize("default", [0.0037, 0.0041, 0.0057])
def test_a_screening_fit_has_one_grid_whatever_the_rounding(
    default: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """1.7 times 0.0037 m is more than 0.00629 m by a bit."""
    for module in (schedule, spacings):
        monkeypatch.setattr(module, "default_spacing", lambda _capture: default)
    coarse = screening_spacing(bar_capture())
    plan = plan_of(bar_capture(), coarse, warm=False, screening=True)
    assert [stage.spacing for stage in plan] == [coarse] * 3


@pytest.mark.parametrize("valley", [0.5, 1.5, 2.2])
def test_a_valley_between_two_scales_is_found(valley: float) -> None:
    """A swing and more fits between two scales: at both of them the model is as far off."""
    start = bar_belief(bar_capture(), youngs_modulus=1e5, free=FREE)

    def evaluate(belief: Belief, *, jacobian: bool) -> SimpleNamespace:
        away = np.log(belief[FREE[0]].value / 1e5 / valley)
        return SimpleNamespace(cost=2e4 * (1.0 + 0.02 * abs(away)) - 1.9e4 * np.exp(-((away / 0.3) ** 2)))

    found = stiffness_scale.find_scale(SimpleNamespace(evaluate=evaluate), start)[FREE[0]].value
    assert abs(np.log(found / 1e5 / valley)) < 0.15


@pytest.mark.parametrize("young", [3e7, 500.0])
def test_a_stiffness_beyond_the_usual_ones_is_found(young: float) -> None:
    shake = 0.004 * np.sin(np.linspace(0.0, 6.0, 12))[:, None] * [0.0, 1.0, 0.5]
    capture = bar_capture(frames=12, fps=200.0, motion=shake, fit=(0, 12), gravity=np.zeros(3), sigma=1e-6)
    truth = bar_belief(capture, youngs_modulus=young, free=FREE)
    made = recorded(capture, truth)
    problem = Experiment.of(made, Settings(0.01, workers=1)).problem(0.01)
    start = truth.with_parameter(FREE[0], value=1e5)
    tried: list[str] = []
    found = stiffness_scale.find_scale(problem, start, tried.append)[FREE[0]].value
    # Scales are half a decade apart.
    assert abs(np.log10(found / young)) < 0.3
    assert len(tried) > len(stiffness_scale.SCALES)
    # It ends at the bounds, not beyond them.
    bounded = start.with_parameter(FREE[0], upper=5e6)
    assert stiffness_scale.find_scale(problem, bounded)[FREE[0]].value <= 5e6
