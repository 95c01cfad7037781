"""Which grid a model of the loop stands on."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import (
    assessment_of,
    evaluation_of,
    excess_of,
    plain_belief,
    recorded,
    solution_of,
    step_of,
)
from mphygs.compare.assess import LARGEST_GRID_ERROR
from mphygs.diagnose import grid_error
from mphygs.extend import coarse_grid_search as probing
from mphygs.extend import finer_grid, grids, required_grid
from mphygs.extend import onset_transfer as meeting
from mphygs.extend import step as extend_step
from mphygs.extend.step import Step, excess, staying
from mphygs.extend.steps import restored, state_of, step_at
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.spacings import deciding_spacing, default_spacing, screening_spacing
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Settings

FREE = ("part0.youngs_modulus",)
COARSE, FINE = 0.01, 0.0075


@cache
def scene() -> tuple[Experiment, Belief]:
    """A bar recorded on the fine grid, and what is true of it."""
    capture = bar_capture(frames=16, fps=100.0, fit=(0, 16))
    truth = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    return Experiment.of(recorded(capture, truth, FINE), Settings(COARSE, workers=1)), truth


@cache
def deciding() -> float:
    """Spacing on which models are decided between."""
    return deciding_spacing(scene()[0].capture)


def trying() -> float:
    return screening_spacing(scene()[0].capture)


def test_spacings_are_those_of_250_cells_and_fewer() -> None:
    default = default_spacing(scene()[0].capture)
    assert default == pytest.approx((0.066 * 0.02 * 0.02 / 250.0) ** (1.0 / 3.0), rel=0.01)
    assert trying() == pytest.approx(1.7 * default, rel=1e-3)
    assert deciding() == pytest.approx(1.28 * default, rel=1e-3)


# ---- the next spacing -------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("ratios", "added", "factor", "asked"),
    [
        # gross, nothing added: the coarse grid will do
        ((10.0, 9.0), (), 1.7, False),
        # a misfit that could be the grid's own
        ((10.0, 2.9), (), 1.7, True),
        ((10.0, 3.1), (), 1.7, False),
        # an effect that left little of the first model's misfit, gross as it is
        ((20.0, 5.0), ("viscosity",), 1.7, True),
        ((20.0, 5.0), (), 1.7, False),
        ((20.0, 9.0), ("viscosity",), 1.7, False),
        # fine already
        ((10.0, 2.0), ("viscosity",), 1.05, False),
    ],
)
def test_the_default_grid_is_asked_where_the_misfit_may_be_the_grids_own(
    ratios: tuple[float, float],
    added: tuple[str, ...],
    factor: float,
    asked: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(grid_error, "unabsorbed", lambda *_: 0.0)
    first, last = (step_of(assessment_of(r), spacing=factor * deciding()) for r in ratios)
    found = required_grid.next_spacing(scene()[0], [first, replace(last, added=added)])
    assert found == (deciding() if asked else None)


@pytest.mark.parametrize(
    ("own", "before", "added", "asked"),
    [
        (9.0, 20.0, ("viscosity",), True),
        # less than is left: 8.94 sigma beyond noise
        (8.9, 20.0, ("viscosity",), False),
        # too little was explained for it to be worth the work, or nothing was added
        (9.0, 12.0, ("viscosity",), False),
        (9.0, 20.0, (), False),
    ],
)
def test_the_default_grid_is_asked_where_the_coarse_one_may_have_all_that_is_left(
    own: float, before: float, added: tuple[str, ...], asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grid_error, "unabsorbed", lambda *_: own)
    first, last = (step_of(assessment_of(r), spacing=trying()) for r in (before, 9.0))
    last = replace(last, added=added, solution=solution_of(plain_belief(), evaluation_of(8100.0)))
    assert required_grid.next_spacing(scene()[0], [first, last]) == (deciding() if asked else None)


@pytest.mark.parametrize(
    ("own", "misfit", "added", "asked"),
    [
        (1.8, 2.0, (), True),
        # less than is left: 1.73 sigma beyond noise
        (1.7, 2.0, (), False),
        # far off in the fitted frames as well
        (9.0, 3.1, (), False),
        (1.8, 2.0, ("viscosity",), False),
    ],
)
def test_a_first_model_that_the_coarse_grid_may_have_bent_is_asked_again(
    own: float, misfit: float, added: tuple[str, ...], asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Gross in unseen frames, not in those fitted."""
    monkeypatch.setattr(grid_error, "unabsorbed", lambda *_: own)
    step = step_of(assessment_of(misfit, 5.0), spacing=trying(), chi_square=100.0 * misfit**2)
    found = required_grid.next_spacing(scene()[0], [step, replace(step, added=added)] if added else [step])
    assert found == (deciding() if asked else None)


@pytest.mark.parametrize(
    ("added", "left", "own", "asked"),
    [
        # a second effect that leaves most: only the grid could have the rest
        ("wind", 2.5, 0.5, False),
        ("wind", 2.5, 3.0, True),
        # one that takes most of what was left, and what sets in
        ("wind", 1.9, 0.5, True),
        ("contact", 2.5, 0.5, True),
    ],
)
def test_a_second_effect_that_leaves_most_is_asked_again_where_the_grid_may_have_it(
    added: str, left: float, own: float, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(grid_error, "unabsorbed", lambda *_: own)
    steps = [
        step_of(assessment_of(20.0), spacing=trying()),
        step_of(assessment_of(2.8), added=("air_drag",), spacing=deciding()),
        step_of(assessment_of(left), added=(added,), spacing=trying(), chi_square=100.0 * left**2),
    ]
    assert required_grid.next_spacing(scene()[0], steps) == (deciding() if asked else None)
    # What the effect before left had been told to be physics.
    budget = {"discretisation": 1e-4, "physics": 3.3e-4}
    monkeypatch.setattr(required_grid, "known_budget", lambda step: bool(step.assessment.budget))
    steps[1] = replace(steps[1], assessment=replace(steps[1].assessment, budget=budget))
    if own > 1.0:
        assert asked and required_grid.next_spacing(scene()[0], steps) is None
    else:
        assert required_grid.next_spacing(scene()[0], steps) == (deciding() if asked else None)


def test_what_sets_in_is_judged_by_the_fitted_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grid_error, "unabsorbed", lambda *_: 0.0)

    def seen_and_not(fit: float, predict: float) -> Step:
        ratio = {"a": {"fit": fit, "predict": predict}}
        return step_of(replace(assessment_of(1.0), ratio=ratio), spacing=trying())

    first, last = seen_and_not(9.0, 6.0), seen_and_not(1.5, 5.5)
    for effect, asked in (("contact", True), ("viscosity", False)):
        found = required_grid.next_spacing(scene()[0], [first, replace(last, added=(effect,))])
        assert found == (deciding() if asked else None)
    far = replace(seen_and_not(4.0, 5.5), added=("contact",))
    assert required_grid.next_spacing(scene()[0], [first, far]) is None


def test_the_first_model_is_asked_again_as_well() -> None:
    only = step_of(assessment_of(2.0), spacing=trying())
    assert required_grid.next_spacing(scene()[0], [only]) == deciding()
    gross = step_of(assessment_of(8.0), spacing=trying(), chi_square=6400.0)
    assert required_grid.next_spacing(scene()[0], [gross]) is None


# ---- another grid -----------------------------------------------------------------------------
def test_a_step_is_refitted_on_another_grid() -> None:
    experiment, truth = scene()
    before = step_at(experiment, truth.with_parameter(FREE[0], value=7e4), COARSE, added=("viscosity",))
    said: list[str] = []
    after = grids.on_grid(experiment, before, FINE, said.append)
    assert (after.spacing, after.added, after.refits) == (FINE, ("viscosity",), before.refits)
    assert after.belief[FREE[0]].value == pytest.approx(6e4, rel=0.01)
    assert after.solution.belief is after.belief
    assert after.assessment.worst < 1.2 < before.assessment.worst
    assert after.assessment.ratio == experiment.assess(experiment.compare(after.belief, FINE)).ratio
    assert "7.5 mm" in said[0] and "->" in said[-1]


@pytest.mark.parametrize("hidden", [0.0, 60.0])
def test_missing_physics_stays_on_a_finer_grid_and_the_grids_error_falls(hidden: float) -> None:
    capture = bar_capture(frames=16, fps=100.0, fit=(0, 16))
    truth = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    told = truth.with_effect("mass_damping").with_parameter("mass_damping.alpha", value=hidden)
    experiment = Experiment.of(recorded(capture, told, 0.6 * FINE), Settings(COARSE, workers=1))
    coarse = grids.on_grid(experiment, step_at(experiment, truth, FINE), COARSE)
    once = grids.on_grid(experiment, coarse, FINE)
    assert coarse.assessment.worst > 1.2 and not coarse.persists
    # Once may be a grid that is too coarse to converge; twice is none.
    assert once.persists is (hidden > 0.0) and not once.stays
    # What is missing would stay on an ever finer grid, the grid's own error falls.
    assert coarse.excess_beyond is None
    assert (once.excess_beyond > excess(once.assessment)) is (hidden > 0.0)
    # Of another model, an effect less say, nothing is known of an ever finer grid.
    assert once.refitted(coarse.solution, coarse.compared, coarse.assessment).excess_beyond is None
    fine = finer_grid.on_finer_grid(experiment, once)
    assert fine.stays is (hidden > 0.0)
    if hidden:
        # No budget excuses it, now or when the loop is resumed.
        known = grids.with_budget(experiment, replace(once, compared=staying(once.compared)))
        assert known.stays and known.assessment.budget["discretisation"] == 0.0
        for step in (known, fine):
            assert all(item.stays for item in finer_grid.compared_as_step(experiment, step, truth).values())
        kept = restored(experiment, state_of(known), {"added": [], "ties": []})
        assert kept.stays and kept.persists and kept.excess_beyond == known.excess_beyond > 0.0


@pytest.mark.parametrize(
    ("fit", "worst", "converged", "asked"),
    [
        # all that a finer grid could take away leaves it far beyond the floor
        (1.3, 2.8, False, ["first"]),
        # near enough that it may
        (1.3, 2.0, False, ["first", "roughly"]),
        (1.2, 2.0, False, ["first", "rest"]),
        (1.3, 2.8, True, ["first"]),
        # fitted frames at the floor: to the last digits where others are near it
        (1.05, 1.6, True, ["first", "last digits"]),
        # where they are farther off, on along the valley in which these do not tell
        (1.05, 1.7, True, ["first", "along the valley"]),
        (1.05, 2.8, False, ["first", "along the valley"]),
    ],
)
def test_a_fit_on_a_finer_grid_goes_on_where_it_may_come_near_the_floor(
    fit: float, worst: float, converged: bool, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 2.9 sigma on the coarse grid, 1.33 times the spacing: what falls from 2.9 to 2.8 ends at 2.7."""
    done: list[str] = []

    def minimise(
        _problem: object, belief: Belief, *, iterations: int, relative_tolerance: float, **_: object
    ) -> Solution:
        last = relative_tolerance == grids.LAST_DIGITS
        rest = "roughly" if relative_tolerance == grids.ROUGHLY else "rest"
        digits = "along the valley" if iterations == grids.ITERATIONS else "last digits"
        done.append(digits if last else "first" if iterations == grids.FIRST else rest)
        return replace(solution_of(belief, evaluation_of(100.0 * fit**2)), converged=converged)

    experiment = SimpleNamespace(
        problem=lambda _spacing: None,
        compare=lambda _belief, _spacing, *, jacobian: {},
        assess=lambda _compared: assessment_of(fit, worst),
    )
    monkeypatch.setattr(grids, "minimise", minimise)
    monkeypatch.setattr(grids, "simulable", lambda _problem, belief: belief)
    monkeypatch.setattr(grids, "jacobian_source", lambda *_: None)
    monkeypatch.setattr(grids, "with_tangents", lambda _experiment, compared, *_: compared)
    monkeypatch.setattr(extend_step, "ratios_at_zero_spacing", lambda *_: {"s0": {"fit": worst}})
    step = step_of(assessment_of(2.9), added=("air_drag",), spacing=COARSE)
    found = grids.on_grid(experiment, step, FINE)
    assert found is not None and found.assessment.worst == worst
    assert done == asked
    # What sets in may still be met, and a first model is what others are told from.
    if asked == ["first"] and not converged:
        for added in (("contact",), ()):
            done.clear()
            grids.on_grid(experiment, replace(step, added=added), FINE)
            assert len(done) == 2 and done[0] == "first"
    # Of what sets in the last digits are the grid's.
    if asked == ["first", "rest"]:
        done.clear()
        grids.on_grid(experiment, replace(step, added=("contact",)), FINE)
        assert done == ["first", "roughly"]


@pytest.mark.parametrize(
    ("misfits", "creeps"),
    [
        # five more of the last two's better fall leave 1.32 sigma, and 1.21
        ((1.41, 1.375, 1.372, 1.363), True),
        ((1.41, 1.375, 1.371, 1.345), False),
        # it falls well
        ((1.43, 1.40, 1.35, 1.31), False),
        ((1.41, 1.35, 1.345), False),
        # near the noise it may be the grid's
        ((1.26, 1.25, 1.245, 1.24), False),
        # no fall is known
        ((1.4,), False),
    ],
)
def test_a_fit_creeps_that_stays_clear_of_the_noise_whatever_falls_next(
    misfits: tuple[float, ...], creeps: bool
) -> None:
    evaluation = evaluation_of(100.0 * misfits[-1] ** 2)
    history = tuple(0.5 * 100.0 * m**2 for m in misfits)
    solution = Solution(scene()[1], evaluation, history, False, "iterations used up")
    assert grids._creeps(solution) is creeps


@pytest.mark.parametrize(
    ("worst", "creeps", "out"), [(2.6, True, True), (2.6, False, False), (2.3, True, False)]
)
def test_a_fit_that_creeps_is_out_of_reach_sooner(
    worst: float, creeps: bool, out: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 2.9 sigma on the coarse grid: twice what falls to 2.6 ends at 1.8, six times at 0.3."""
    monkeypatch.setattr(grids, "_creeps", lambda _solution: creeps)
    experiment = SimpleNamespace(
        compare=lambda _belief, _spacing, *, jacobian: {}, assess=lambda _compared: assessment_of(1.4, worst)
    )
    step = step_of(assessment_of(2.9), added=("air_drag",), spacing=COARSE)
    solution = replace(step.solution, converged=False)
    assert grids._out_of_reach(experiment, step, solution, FINE) is out


@pytest.mark.parametrize(("spacing", "kept"), [(FINE, "softer"), (2.0 * COARSE, "as it was")])
def test_a_part_of_stone_begins_softer_on_a_finer_grid_where_that_fits_better(
    spacing: float, kept: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment, truth = scene()
    stone = truth.with_parameter(FREE[0], value=50.0 * truth[FREE[0]].value)
    begun: list[float] = []

    def minimise(_problem: object, belief: Belief, **_: object) -> Solution:
        begun.append(belief[FREE[0]].value)
        raise SimulationError("far enough")

    monkeypatch.setattr(grids, "minimise", minimise)
    monkeypatch.setattr(grids, "without_stiffest", lambda _belief: truth)
    step = replace(step_of(assessment_of(2.0), added=("air_drag",), spacing=COARSE), belief=stone)
    assert grids.on_grid(experiment, step, spacing) is None
    assert begun == [truth[FREE[0]].value if kept == "softer" else stone[FREE[0]].value]
    # Where it fits better as it was it stays.
    monkeypatch.setattr(grids, "without_stiffest", lambda _belief: stone)
    grids.on_grid(experiment, replace(step, belief=truth), spacing)
    assert begun[1:] == [truth[FREE[0]].value]


@pytest.mark.parametrize(("worst", "tangents"), [(1.6, True), (1.7, False)])
def test_no_tangents_are_asked_of_what_they_cannot_excuse_on_a_grid_that_is_left(
    worst: float, tangents: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []
    done = step_of(assessment_of(1.0, adequate=True), added=("wind",), spacing=deciding())
    monkeypatch.setattr(required_grid, "complete", lambda _e, step, **_: asked.append(step.spacing) or step)
    monkeypatch.setattr(required_grid, "on_grid", lambda *_: done)
    first = step_of(assessment_of(20.0), spacing=trying())
    step = step_of(assessment_of(worst), added=("wind",), spacing=trying())
    assert required_grid.on_required_grid(scene()[0], [first, step], None, screening=True) is done
    assert asked == ([trying()] if tangents else [])


@pytest.mark.parametrize(
    ("worst", "spacing", "screening", "asked"),
    [
        (1.6, "coarse", True, True),
        (1.7, "coarse", True, False),
        (1.7, "coarse", False, True),  # the grid that was asked for decides
        (1.7, "deciding", True, True),
        (5.1, "deciding", True, False),
    ],
)
def test_a_grid_for_trying_asks_no_tangents_of_what_no_test_excuses(
    worst: float, spacing: str, screening: bool, asked: bool
) -> None:
    experiment, truth = scene()
    grid = trying() if spacing == "coarse" else deciding()
    compared = experiment.compare(truth, grid, jacobian=False)
    step = replace(step_of(assessment_of(worst), spacing=grid), belief=truth, compared=compared)
    done = grids.complete(experiment, step, screening=screening)
    assert [item.jacobian.shape[-1] for item in done.compared.values()] == [len(FREE) if asked else 0]


def test_a_rival_goes_without_tangents_until_it_is_kept() -> None:
    experiment, truth = scene()
    before = step_at(experiment, truth.with_parameter(FREE[0], value=7e4), COARSE, added=("viscosity",))
    assert grids.complete(experiment, before) is before
    rival = grids.on_grid(experiment, before, FINE, tangents=False)
    assert [item.jacobian.shape[-1] for item in rival.compared.values()] == [0]
    kept = grids.complete(experiment, rival)
    assert [item.jacobian.shape[-1] for item in kept.compared.values()] == [len(FREE)]
    assert kept.assessment.ratio == rival.assessment.ratio
    # what one stiffness absorbs is one degree of freedom
    assert kept.assessment.floor.degrees == rival.assessment.floor.degrees - len(FREE)
    assert required_grid.on_required_grid(
        experiment, [before, rival], None, screening=False
    ).assessment.adequate


@pytest.mark.parametrize("worst", [1.05, 1.2, 1.7])
def test_the_tangents_on_all_frames_are_the_coarse_grids_where_they_decide_nothing(
    monkeypatch: pytest.MonkeyPatch, worst: float
) -> None:
    experiment, truth = scene()
    own, lent = (experiment.compare(truth, spacing) for spacing in (deciding(), trying()))
    monkeypatch.setattr(Experiment, "assess", lambda *_: SimpleNamespace(worst=worst))
    found = finer_grid.with_tangents(
        experiment, experiment.compare(truth, deciding(), jacobian=False), truth, deciding()
    )
    for name, item in found.items():
        assert np.array_equal(item.predicted, own[name].predicted, equal_nan=True)
        wanted = own if worst == 1.2 else lent
        assert item.tangents_of == (deciding() if worst == 1.2 else trying())
        assert np.array_equal(item.jacobian, wanted[name].jacobian, equal_nan=True)
        assert not np.array_equal(own[name].jacobian, lent[name].jacobian, equal_nan=True)

    def unstable(*_: object, **__: object) -> None:
        raise SimulationError("too soft")

    monkeypatch.setattr(experiment.predictor("a", trying()), "predict", unstable)
    experiment.predictor("a", trying()).forget()
    kept = finer_grid.with_tangents(experiment, found, truth, deciding())
    assert np.array_equal(kept["a"].jacobian, own["a"].jacobian, equal_nan=True)


def test_a_gross_misfit_asks_for_no_tangents_on_all_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, truth = scene()
    without = experiment.compare(truth, COARSE, jacobian=False)
    monkeypatch.setattr(Experiment, "assess", lambda *_: SimpleNamespace(worst=LARGEST_GRID_ERROR))
    assert finer_grid.with_tangents(experiment, without, truth, COARSE) is without
    assert without["a"].jacobian.shape[-1] == 0
    gross = replace(step_of(assessment_of(LARGEST_GRID_ERROR)), belief=truth, compared=without)
    assert grids.complete(experiment, gross) is gross


def test_no_step_where_another_grid_cannot_carry_the_model(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, truth = scene()

    def unstable(*_: object, **__: object) -> None:
        raise SimulationError("unstable at frame 3")

    said: list[str] = []
    before = step_at(experiment, truth, COARSE)
    monkeypatch.setattr(grids, "minimise", unstable)
    assert grids.on_grid(experiment, before, FINE, said.append) is None
    assert said[-1] == "grid of 7.5 mm: unstable at frame 3"
    refined = required_grid.on_required_grid(
        experiment, [replace(before, spacing=trying())], None, screening=True
    )
    assert refined.spacing == trying()


def test_the_budget_says_how_much_is_the_grids_own() -> None:
    experiment, truth = scene()
    plain = step_at(experiment, truth, COARSE)
    assert plain.assessment.budget["discretisation"] == 0.0
    known = grids.with_budget(experiment, plain)
    budget = known.assessment.budget
    # The misfit is the grid's alone: the model is the truth.
    assert budget["discretisation"] > 0.5 * (budget["discretisation"] + budget["physics"])
    assert known.belief is plain.belief and known.assessment.ratio == plain.assessment.ratio


# ---- what is done with a step -----------------------------------------------------------------
@cache
def steps_told() -> tuple[float, float]:
    return trying(), deciding()


def told(
    monkeypatch: pytest.MonkeyPatch,
    step: Step,
    *,
    screening: bool,
    tied: bool = False,
    after: Step | None = None,
    shares: tuple[float, float] | None = None,
) -> list:
    """What `on_required_grid` does with a step: ("grid", spacing), "rough" budget and "budget".

    after: the step on the finer grid; shares: discretisation and physics in the rough budget [m].
    """
    done: list = []

    def on_grid(_experiment: object, _step: Step, spacing: float, _report: object) -> Step | None:
        done.append(("grid", spacing))
        return after

    def with_budget(
        _experiment: object, one: Step, _report: object = None, *, refinement_spacing: float | None = None
    ) -> Step:
        assert refinement_spacing in (None, trying())
        done.append("budget" if refinement_spacing is None else "rough")
        if refinement_spacing is None or shares is None:
            return one
        budget = dict(zip(("discretisation", "physics"), shares, strict=True))
        return replace(one, assessment=replace(one.assessment, budget=budget))

    for module in (grids, required_grid):
        monkeypatch.setattr(module, "known_budget", lambda one: bool(one.assessment.budget))
    monkeypatch.setattr(required_grid, "on_grid", on_grid)
    monkeypatch.setattr(required_grid, "with_budget", with_budget)
    found = required_grid.on_required_grid(scene()[0], [step], None, screening=screening, tied=tied)
    expected = after if ("grid", deciding()) in done and after is not None else step
    assert found.belief is expected.belief and found.spacing == expected.spacing
    return done


@pytest.mark.parametrize("left", [False, True])
def test_what_the_finer_grid_leaves_is_known_of_the_step_that_stays(
    monkeypatch: pytest.MonkeyPatch, left: bool
) -> None:
    experiment, truth = scene()
    fine = steps_told()[1]
    near = step_at(experiment, truth.with_parameter(FREE[0], value=6.2e4), fine, added=("viscosity",))
    after = replace(near, compared=staying(near.compared)) if left else near
    monkeypatch.setattr(required_grid, "excess", lambda assessment: float(assessment.worst >= 9.0))
    monkeypatch.setattr(required_grid, "on_finer_grid", lambda *_: after)
    monkeypatch.setattr(required_grid, "with_budget", lambda _e, step, *_, **__: step)
    monkeypatch.setattr(required_grid, "misses_physics", lambda _step: False)
    first = step_of(assessment_of(9.0), spacing=fine)
    found = required_grid.on_required_grid(experiment, [first, near], None, screening=True)
    assert 1.2 < near.assessment.worst < LARGEST_GRID_ERROR and found.belief is near.belief
    assert found.stays is left


def test_only_a_grid_for_screening_is_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    coarse, fine = steps_told()
    near = step_of(assessment_of(2.0), spacing=coarse)
    moved = step_of(assessment_of(1.6), spacing=fine)
    assert told(monkeypatch, near, screening=True, after=moved) == [("grid", fine), "rough", "budget"]
    # A spacing that was asked for stays; its budget is told there.
    assert told(monkeypatch, near, screening=False) == ["budget"]
    # Explained on the finer grid: nothing is left to be shared out.
    done = replace(moved, assessment=assessment_of(1.0, adequate=True))
    assert told(monkeypatch, near, screening=True, after=done) == [("grid", fine)]
    # Where the finer grid cannot carry it, the coarse one's error is no budget for the default grid.
    assert told(monkeypatch, near, screening=True, after=None) == [("grid", fine)]


def test_what_is_far_more_than_the_grids_share_is_asked_no_finer_one(monkeypatch: pytest.MonkeyPatch) -> None:
    _, fine = steps_told()
    step = step_of(assessment_of(4.0), spacing=fine)
    most = grids.BEYOND
    assert told(monkeypatch, step, screening=True, shares=(1e-4, 1.1e-4 * most)) == ["rough"]
    assert told(monkeypatch, step, screening=True, shares=(1e-4, 0.9e-4 * most)) == ["rough", "budget"]
    # A spacing that was asked for has no screening grid.
    assert told(monkeypatch, step, screening=False, shares=(1e-4, 1.1e-4 * most)) == ["budget"]
    # So little is left that the floor test decides, with the share that a finer grid shows.
    for worst, asked in ((1.45, ["budget"]), (1.55, ["rough"])):
        step = step_of(assessment_of(worst), spacing=fine)
        assert told(monkeypatch, step, screening=True, shares=(1e-4, 1.1e-4 * most)) == asked


def test_a_step_that_is_explained_or_far_off_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    coarse, fine = steps_told()
    explained = step_of(assessment_of(1.0, adequate=True), spacing=coarse)
    assert told(monkeypatch, explained, screening=True) == []
    assert told(monkeypatch, replace(explained, spacing=fine), screening=True) == []
    enough = step_of(assessment_of(1.08), added=("viscosity",), spacing=coarse)
    assert told(monkeypatch, enough, screening=True) == []
    # Of those that do alike the default grid tells, however little is left on the coarse one.
    decided = replace(enough, spacing=fine)
    assert told(monkeypatch, enough, screening=True, tied=True, after=decided) == [("grid", fine)]
    assert told(monkeypatch, decided, screening=True, tied=True) == []
    assert told(monkeypatch, enough, screening=False, tied=True) == []
    far = step_of(assessment_of(LARGEST_GRID_ERROR + 0.1), spacing=fine)
    assert told(monkeypatch, far, screening=False) == []
    assert told(monkeypatch, replace(far, assessment=assessment_of(4.0)), screening=False) == ["budget"]


# ---- the grid for a search --------------------------------------------------------------------
def probe(monkeypatch: pytest.MonkeyPatch, fine: Step, coarse: Step | None) -> Step:
    monkeypatch.setattr(probing, "on_grid", lambda _e, _s, spacing, _r, **_: coarse)
    return probing.on_coarse_grid(scene()[0], fine, trying())


def test_causes_are_looked_for_on_a_coarser_grid_that_has_the_same_misfit(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    coarse, fine = steps_told()
    here = step_of(assessment_of(3.0, 1.0), spacing=fine)
    alike = step_of(assessment_of(1.0, 3.8), spacing=coarse)
    assert probe(monkeypatch, here, alike) is alike
    assert probe(monkeypatch, here, replace(alike, assessment=assessment_of(4.0))) is here
    assert probe(monkeypatch, here, None) is here
    # On that grid already: nothing is computed.
    there = replace(here, spacing=coarse)
    assert probe(monkeypatch, there, alike) is there


def test_a_search_on_a_coarser_grid_begins_where_the_model_was_on_it(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, truth = scene()
    begun: list[Belief] = []
    monkeypatch.setattr(probing, "on_grid", lambda _e, step, _s, _r, **_: begun.append(step.belief))
    near, far = (truth.with_parameter(FREE[0], value=6e4 * factor) for factor in (0.99, 1.5))
    for rough, now, expected in ((near, far, near), (far, near, near), (None, far, far)):
        here = replace(step_of(assessment_of(3.0)), spacing=FINE, belief=now, coarse_belief=rough)
        probing.on_coarse_grid(experiment, here, COARSE)
        assert begun.pop() is expected
    # A model that has changed since begins where it is.
    fixed = near.with_parameter(FREE[0], free=False)
    other = replace(step_of(assessment_of(3.0)), spacing=FINE, belief=far, coarse_belief=fixed)
    probing.on_coarse_grid(experiment, other, COARSE)
    assert begun.pop() is far


def test_a_step_on_a_finer_grid_knows_where_it_was_on_the_coarser() -> None:
    experiment, truth = scene()
    step = step_at(experiment, truth.with_parameter(FREE[0], value=6.3e4), COARSE)
    fine = grids.on_grid(experiment, step, FINE, tangents=False)
    assert fine.coarse_belief is step.belief is not fine.belief
    assert grids.on_grid(experiment, fine, COARSE, tangents=False).coarse_belief is None


class Recordings:
    """An experiment of two recordings, that knows only which."""

    def only(self, names: tuple[str, ...]) -> Recordings:
        inner = Recordings()
        inner.names = names
        return inner

    def starting(self, belief: Belief) -> Belief:
        return belief.with_parameter(FREE[0], value=1e3)


def test_causes_of_the_others_misfit_are_looked_for_from_what_explains_the_simplest(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    coarse, fine = steps_told()
    # s0 is explained, s1 is not: fitted to both, the model would explain neither.
    here = step_of(assessment_of(1.05, 20.0), added=("viscosity",), spacing=fine)
    alone = step_of(assessment_of(1.02), added=("viscosity",), spacing=coarse)
    whole = step_of(assessment_of(1.03, 22.0), added=("viscosity",), spacing=coarse)
    went: list[object] = []

    def on_grid(inner: Recordings, step: Step, spacing: float, _report: object, *, tangents: bool) -> Step:
        assert not tangents
        went.append((inner.names, step.belief[FREE[0]].value, spacing))
        return alone

    def among_all(_experiment: object, first: Belief, step: Step) -> Step:
        went.append((first, step))
        return whole

    monkeypatch.setattr(probing, "on_grid", on_grid)
    monkeypatch.setattr(probing, "compared_on_all", among_all)
    assert probing.on_coarse_grid(Recordings(), here, coarse, simple=("s0",)) is whole
    assert went == [(("s0",), 1e3, coarse), (here.belief, alone)]
    # The simplest are not explained on that grid: nothing is seen from there.
    whole = replace(whole, assessment=assessment_of(1.2, 22.0))
    assert probing.on_coarse_grid(Recordings(), here, coarse, simple=("s0",)) is here

    # Nor where that grid cannot carry the others.
    def unstable(*_: object) -> Step:
        raise SimulationError("unstable")

    monkeypatch.setattr(probing, "compared_on_all", unstable)
    assert probing.on_coarse_grid(Recordings(), here, coarse, simple=("s0",)) is here


def test_excess_is_the_mean_over_ranges_of_what_noise_does_not_explain() -> None:
    assert required_grid.excess(assessment_of(2.0, 0.5)) == pytest.approx(1.5)
    assert required_grid.excess(excess_of(0.3)) == pytest.approx(0.3)
    assert np.isclose(required_grid.excess(assessment_of(1.0)), 0.0)


# ---- the last digits --------------------------------------------------------------------------
def test_what_is_concluded_is_told_to_its_last_digits() -> None:
    experiment, truth = scene()
    near = step_at(experiment, truth.with_parameter(FREE[0], value=6.03e4), FINE, added=("viscosity",))
    best = step_at(experiment, truth, FINE, added=("viscosity",)).solution.evaluation.cost
    said: list[str] = []
    after = grids.converged_fit(experiment, near, said.append)
    assert after.solution.evaluation.cost < min(near.solution.evaluation.cost, best + 1e-6)
    assert after.explained and "last digits" in said[0]
    again = grids.converged_fit(experiment, after)
    assert again.belief[FREE[0]].value == pytest.approx(after.belief[FREE[0]].value, rel=1e-5)


def test_what_the_grid_excuses_is_excused_after_the_last_digits() -> None:
    experiment, truth = scene()
    near = step_at(experiment, truth.with_parameter(FREE[0], value=6.03e4), FINE, added=("viscosity",))
    known = grids.with_budget(experiment, near)
    assert grids.known_budget(known) and grids.known_budget(grids.converged_fit(experiment, known))
    assert not grids.known_budget(grids.converged_fit(experiment, near))


def test_a_step_that_loses_its_floor_in_the_last_digits_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, truth = scene()
    near = step_at(experiment, truth.with_parameter(FREE[0], value=6.03e4), FINE, added=("viscosity",))
    monkeypatch.setattr(experiment, "assess", lambda _compared: assessment_of(9.0))
    assert grids.converged_fit(experiment, near) is near


def test_no_last_digits_where_the_grid_is_the_excuse() -> None:
    experiment, truth = scene()
    near = step_at(experiment, truth.with_parameter(FREE[0], value=6.03e4), FINE, added=("viscosity",))
    excused = replace(near, assessment=assessment_of(1.2, adequate=True))
    assert grids.converged_fit(experiment, excused) is excused


# ---- what sets in, on another grid ------------------------------------------------------------
@pytest.mark.parametrize(
    ("direct", "anew", "taken", "asked"),
    [
        # near the floor from the coarse grid's model: nothing more is asked
        (1.1, 1.0, "direct", 0),
        # else the better of the two
        (1.3, 1.2, "anew", 1),
        (1.3, 1.4, "direct", 1),
        # one of them cannot be simulated
        (None, 1.4, "anew", 1),
        (1.3, None, "direct", 1),
    ],
)
def test_what_sets_in_is_met_from_the_coarse_grids_model_or_from_before_it(
    direct: float | None, anew: float | None, taken: str, asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment, truth = scene()
    # The belief tells itself by its stiffness.
    young = {"direct": 5e4, "anew": 7e4}
    misfits = {young["direct"]: direct, young["anew"]: anew}
    starts: list[float] = []

    class Asked:
        def evaluate(self, belief: Belief, *, jacobian: bool) -> SimpleNamespace:
            assert not jacobian
            misfit = misfits[belief[FREE[0]].value]
            return SimpleNamespace(misfit=misfit, cost=misfit**2)

    def approached(problem: Asked, _jacobian_problem: object, belief: Belief, **_: object) -> Belief:
        if misfits[belief[FREE[0]].value] is None:
            raise SimulationError("unstable")
        return belief

    def followed(*_: object) -> Belief:
        starts.append(1.0)
        return truth.with_parameter(FREE[0], value=young["anew"])

    monkeypatch.setattr(type(experiment), "problem", lambda _self, _spacing: Asked())
    monkeypatch.setattr(meeting, "with_onset_fitted", lambda _p, belief, **_: belief)
    monkeypatch.setattr(meeting, "approached", approached)
    monkeypatch.setattr(meeting, "onset_refitted", followed)
    coarse = truth.with_parameter(FREE[0], value=young["direct"])
    found = meeting.onset_on_grid(experiment, coarse, 0.5, object(), FINE)
    assert found[FREE[0]].value == young[taken] and len(starts) == asked
    # Without a coarser grid to lend its Jacobians it begins from before.
    assert meeting.onset_on_grid(experiment, coarse, 0.5, None, FINE)[FREE[0]].value == young["anew"]


@pytest.mark.parametrize(
    ("here", "there", "changes", "kept"),
    [
        (1.1, 1.04, {}, True),
        (1.1, 1.2, {}, False),
        # it could not be simulated there
        (1.1, None, {}, False),
        # at the noise; on a fine grid; by Jacobians of another; what sets in; fitted to all frames
        (1.02, 1.01, {}, False),
        (1.1, 1.04, {"spacing": None}, False),
        (1.1, 1.04, {"jacobian_spacing": 0.01}, False),
        (1.1, 1.04, {"added": ("contact",)}, False),
        (1.1, 1.04, {"reconciled": True}, False),
    ],
)
def test_what_is_concluded_is_told_of_a_fine_grid_where_it_leaves_less(
    here: float, there: float | None, changes: dict, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "spacing" in changes:
        changes = {"spacing": deciding() / 1.28}
    step = replace(step_of(assessment_of(here, adequate=True), spacing=deciding()), **changes)
    after = there and step_of(assessment_of(there, adequate=True), spacing=deciding() / finer_grid.FINER)
    monkeypatch.setattr(grids, "on_finer_grid", lambda *_: after)
    assert grids.finely(scene()[0], step) is (after if kept else step)


@pytest.mark.parametrize(
    ("coarse", "fine", "beyond"),
    [(2.868, 2.791, True), (3.6, 2.8, False), (2.0, 1.4, False), (2.0, 2.1, True)],
)
def test_no_finer_grid_is_asked_where_two_grids_say_that_it_would_be_too_little(
    coarse: float, fine: float, beyond: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A tenth of the first model's misfit is left, on a grid three quarters as coarse."""
    experiment = scene()[0]
    first = step_of(assessment_of(60.0), spacing=trying())
    last = step_of(assessment_of(coarse), added=("air_drag",), free=1, spacing=trying())
    moved = step_of(assessment_of(fine), added=("air_drag",), free=1, spacing=deciding())
    asked: list[str] = []
    monkeypatch.setattr(required_grid, "complete", lambda _e, step: step)
    monkeypatch.setattr(required_grid, "next_spacing", lambda *_: deciding())
    monkeypatch.setattr(required_grid, "on_grid", lambda *_, **__: moved)
    monkeypatch.setattr(required_grid, "known_budget", lambda _step: False)
    monkeypatch.setattr(required_grid, "with_budget", lambda _e, step, *_, **__: step)
    monkeypatch.setattr(required_grid, "on_finer_grid", lambda *_: asked.append("finer"))
    assert required_grid.on_required_grid(experiment, [first, last], None, screening=True) is moved
    assert asked == ([] if beyond else ["finer"])
