"""The rules of the loop: where it looks, what it tries, what it keeps, what it concludes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from extend_example import (
    SPACING,
    assessment_of,
    entry_of,
    evaluation_of,
    excess_of,
    plain_belief,
    refit_of,
    solution_of,
    step_of,
)
from mphygs.capture.markers import Markers
from mphygs.capture.track_faults.tracks import Finding
from mphygs.compare.noise import Observation
from mphygs.compare.whitening import NoiseModel
from mphygs.diagnose.held_out import GainInterval
from mphygs.diagnose.ranking import RankedEffect, Ranking
from mphygs.extend import (
    conclusion,
    discovery,
    finished_refits,
    first_window,
    grids,
    model_selection,
    refits,
    required_grid,
    window_continuation,
)
from mphygs.extend.first_window import tractable_window
from mphygs.extend.model_selection import selected_model
from mphygs.extend.onset_transfer import growing_shares
from mphygs.extend.refit import Refit
from mphygs.extend.refits import promising, refits_of
from mphygs.extend.seen_faults import fault_names, seen_faults
from mphygs.extend.step import Step
from mphygs.fit.belief_document import belief_from_document, document_of_belief
from mphygs.fit.levenberg_marquardt import Solution
from mphygs.fit.problem import Evaluation
from mphygs.fit.schedule import TRACTABLE
from mphygs.fit.stiffness_scale import CONTRAST, about_its_scale
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

# An experiment on one core, of which nothing else is asked.
ALONE = SimpleNamespace(settings=SimpleNamespace(workers=1), capture=None)
UNSEEN = SimpleNamespace(capture=SimpleNamespace(sequences=()), observations={})


@pytest.fixture(autouse=True)
def grid_of_no_capture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there is no capture, all is decided on the grid that there is."""
    deciding = required_grid.deciding_spacing
    for module in (grids, required_grid):
        monkeypatch.setattr(module, "deciding_spacing", lambda c: SPACING if c is None else deciding(c))

KEY = "part0.youngs_modulus"

# ---- the window -------------------------------------------------------------------------------
# The share of the frames that a belief was fitted to stands in its Young's modulus [MPa].
Misfit = Callable[[float, float], float]


def fitted_share(belief: Belief) -> float:
    return belief[KEY].value / 1e6


class Window:
    """A problem on the first share of the frames."""

    def __init__(self, misfit: Misfit, share: float, others: float | None) -> None:
        self.misfit, self.share, self.others = misfit, share, others

    def evaluate(self, belief: Belief) -> Evaluation:
        ratio = self.misfit(fitted_share(belief), self.share)
        found = evaluation_of(100.0 * ratio**2)
        if self.others is None:
            return found
        # Half of the rows are a sequence's that is explained.
        explained = np.full(100, self.others)
        rows = {"easy": slice(0, 100), "a": slice(100, 200)}
        return replace(found, residual=np.r_[explained, found.residual], data_rows=200, rows=rows)


class Frames:
    """An experiment whose misfit [sigma] over a share of the frames depends on the share fitted to."""

    def __init__(self, misfit: Misfit, *, whole: tuple[str, ...] = (), others: float | None = None) -> None:
        self.misfit, self.whole, self.others = misfit, whole, others

    def window(self, spacing: float, share: float) -> Window:
        assert spacing == SPACING
        return Window(self.misfit, share, self.others)

    def problem(self, spacing: float) -> Window:
        return self.window(spacing, 1.0)


@pytest.fixture
def fits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Shares that were fitted to, in their order; a fit leaves its share in the belief."""
    done: list[float] = []

    def minimise(window: Window, start: Belief, **_: object) -> Solution:
        done.append(window.share)
        belief = start.with_parameter(KEY, value=1e6 * window.share)
        return solution_of(belief, window.evaluate(belief))

    monkeypatch.setattr(first_window, "minimise", minimise)
    monkeypatch.setattr(first_window, "find_scale", lambda _window, belief: belief)
    monkeypatch.setattr(first_window, "unabsorbed", lambda *_, **__: 0.0)
    return done


def look(
    experiment: Frames, *, added: tuple[str, ...] = (), halfway: Belief | None = None
) -> tuple[float, Solution]:
    belief = plain_belief().with_parameter(KEY, value=1e6)
    solution = solution_of(belief, experiment.problem(SPACING).evaluate(belief))
    step = replace(step_of(assessment_of(9.0), added=added), belief=belief, solution=solution)
    step = replace(step, halfway=halfway)
    return tractable_window(experiment, step, SPACING, lambda _text: None)


def ratio(solution: Solution) -> float:
    return float(np.sqrt(solution.evaluation.chi_square / solution.evaluation.data_rows))


def test_a_misfit_that_is_small_is_looked_at_over_all_frames(fits: list[float]) -> None:
    share, solution = look(Frames(lambda _fitted, _seen: 3.9))
    assert share == 1.0 and fitted_share(solution.belief) == 1.0 and fits == []


@pytest.mark.parametrize(
    ("misfit", "added", "whole"), [(1.2, (), True), (1.3, (), False), (1.3, ("gravity",), True)]
)
def test_a_material_at_its_bound_says_that_the_motion_was_bought(
    misfit: float, added: tuple[str, ...], whole: bool, fits: list[float]
) -> None:
    experiment = Frames(lambda _fitted, _seen: misfit)
    belief = plain_belief().with_parameter(KEY, value=1e6, upper=1e6)
    solution = solution_of(belief, experiment.problem(SPACING).evaluate(belief))
    step = replace(step_of(assessment_of(9.0), added=added), belief=belief, solution=solution)
    share, _ = tractable_window(experiment, step, SPACING, lambda _text: None)
    assert (share == 1.0 and fits == []) is whole
    assert whole or share == fits[-1] == 0.25


def growing(per_share: float) -> Misfit:
    return lambda _fitted, seen: max(1.0, per_share * seen)


@pytest.mark.parametrize(
    ("per_share", "expected"),
    [(6.0, 0.25), (4.1, 0.4), (12.0, 0.25), (22.0, 0.16), (30.0, 0.1), (60.0, 0.06), (90.0, 0.06)],
)
def test_the_window_ends_where_the_misfit_is_visible_but_small(
    per_share: float, expected: float, fits: list[float]
) -> None:
    share, solution = look(Frames(growing(per_share)))
    assert share == fits[-1] == expected and fitted_share(solution.belief) == pytest.approx(share)


def test_what_may_be_the_grids_own_is_followed_over_more_frames(
    fits: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []

    def unabsorbed(_experiment: Frames, spacing: float, belief: Belief, _: object, *, share: float) -> float:
        assert spacing == SPACING and fitted_share(belief) == share
        asked.append(share)
        return 3.6

    monkeypatch.setattr(first_window, "unabsorbed", unabsorbed)
    # 1.64 sigma: 1.3 beyond noise; 2.255: 2.02, more than half of what the grid may have.
    assert look(Frames(growing(4.1)))[0] == 0.55 and asked == [0.4, 0.55]
    # All of it may be the grid's: as many frames as there are windows for.
    monkeypatch.setattr(first_window, "unabsorbed", lambda *_, **__: np.inf)
    assert look(Frames(growing(5.0)))[0] == 0.75
    # The next window is far off: something sets in that the model of the frames before does not have.
    share, solution = look(Frames(lambda fitted, seen: 9.0 if max(fitted, seen) > 0.5 else 1.6))
    assert share == 0.75 and fitted_share(solution.belief) == pytest.approx(0.4)
    assert solution.reason == "seen from before"


def sets_in(at: float, steep: float = 40.0) -> Misfit:
    """Something sets in at a share of the frames: a model of the frames before is right there, one fitted
    beyond is wrong all over."""

    def misfit(fitted: float, seen: float) -> float:
        if fitted <= at:
            return 1.0 + steep * max(seen - at, 0.0)
        return 6.0

    return misfit


def test_what_sets_in_is_seen_from_the_model_of_the_frames_before(fits: list[float]) -> None:
    # Within the frames half way between the last window without misfit and the next.
    share, solution = look(Frames(sets_in(0.45)))
    assert fits == [0.25, 0.4, 0.55] and share == pytest.approx(0.475)
    assert fitted_share(solution.belief) == pytest.approx(0.4) and solution.reason == "seen from before"
    assert ratio(solution) == pytest.approx(2.0)
    # Behind them: over three quarters.
    share, solution = look(Frames(sets_in(0.52)))
    assert share == 0.75 and fitted_share(solution.belief) == pytest.approx(0.4)
    assert ratio(solution) == pytest.approx(1.0 + 40.0 * 0.23)


def test_what_sets_in_late_is_seen_over_all_frames(fits: list[float]) -> None:
    share, solution = look(Frames(sets_in(0.8)))
    assert fits == [0.25, 0.4, 0.55, 0.75] and share == 1.0
    assert fitted_share(solution.belief) == pytest.approx(0.75)
    assert ratio(solution) == pytest.approx(1.0 + 40.0 * 0.2)


def test_what_sets_in_early_is_seen_from_the_few_frames_before(fits: list[float]) -> None:
    # Half way between the first window without misfit and the shortest one with it.
    share, solution = look(Frames(sets_in(0.18)))
    assert fits == [0.25, 0.16] and share == pytest.approx(0.205)
    assert fitted_share(solution.belief) == pytest.approx(0.16) and ratio(solution) == pytest.approx(2.0)
    share, solution = look(Frames(sets_in(0.22)))
    assert share == 0.25 and fitted_share(solution.belief) == pytest.approx(0.16)
    assert ratio(solution) == pytest.approx(2.2)
    share, solution = look(Frames(sets_in(0.12)))
    assert fits[-2:] == [0.16, 0.1] and share == pytest.approx(0.13)
    assert fitted_share(solution.belief) == pytest.approx(0.1)


def test_a_model_with_an_effect_is_not_forgotten(fits: list[float], monkeypatch: pytest.MonkeyPatch) -> None:
    scaled: list[Belief] = []

    def find_scale(_window: Window, belief: Belief) -> Belief:
        scaled.append(belief)
        return belief

    monkeypatch.setattr(first_window, "find_scale", find_scale)
    look(Frames(growing(6.0)), added=("viscosity",))
    assert scaled == []
    look(Frames(growing(6.0)))
    assert len(scaled) == 1


@pytest.mark.parametrize(
    ("left", "own", "passed"), [(2.0, 0.1, True), (2.0, 9.0, False), (1.1, 0.1, False), (4.1, 0.1, False)]
)
def test_a_window_that_the_first_fit_passed_is_not_fitted_again(
    left: float, own: float, passed: bool, fits: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_window, "unabsorbed", lambda *_, **__: own)
    experiment = Frames(lambda fitted, share: left if fitted <= 0.5 else 9.0)
    halfway = plain_belief().with_parameter(KEY, value=5e5)
    share, solution = look(experiment, halfway=halfway)
    if passed:
        assert (share, solution.belief, fits) == (0.5, halfway, [])
        assert ratio(solution) == pytest.approx(left)
    elif left < TRACTABLE:
        # More frames are asked from there, and what sets in after it is seen from it.
        assert (fits, share, solution.belief) == ([0.55], 0.75, halfway)
    else:
        assert fits[0] == 0.25


def test_a_model_that_is_far_off_from_the_start_is_seen_from_softer_materials() -> None:
    costs = {3e4: 9.0, 1e5: 5.0, 3.2e5: 4.9, 1e6: 4.8, 3.2e6: 4.7}
    asked: list[float] = []

    def evaluate(belief: Belief, *, jacobian: bool = True) -> Evaluation:
        young = belief[KEY].value
        asked.append(young)
        misfit = next((sigma for near, sigma in costs.items() if abs(young / near - 1.0) < 0.1), None)
        if misfit is None:
            raise SimulationError("unstable")
        return evaluation_of(100.0 * misfit**2)

    experiment = SimpleNamespace(
        whole=(), window=lambda spacing, share: SimpleNamespace(evaluate=evaluate)
    )
    usual = plain_belief().with_parameter(KEY, value=3e6, prior_mean=np.log(1e5), prior_std=2.0)

    def others(misfit: float, belief: Belief = usual) -> list[float]:
        # The bounds about the stiff one that was found are not theirs.
        belief = about_its_scale(belief)
        solution = solution_of(belief, evaluation_of(100.0 * misfit**2))
        found = first_window.at_other_scales(experiment, (0.06, solution), SPACING)
        assert all(s.belief[KEY].upper == s.belief[KEY].value * CONTRAST for s in found)
        return [s.belief[KEY].value for s in found]

    # The softest that cost at most twice the least: at 30 kPa it is four times as much.
    assert others(4.5) == pytest.approx([1e5, 10**5.5, 1e6])
    # Near enough, or an effect is in the model: what was fitted says something.
    assert others(3.9) == [] and others(4.5, usual.with_effect("viscosity")) == []
    # Where a rest shape is solved for those softer than two that are far worse are not asked.
    assert 1e4 in np.round(asked) and others(4.5) != []
    asked.clear()
    assert others(4.5, replace(usual, prestress="equilibrium")) == pytest.approx([1e5, 10**5.5, 1e6])
    assert min(asked) == pytest.approx(1e4)


@pytest.mark.parametrize("later", [0.52, 0.8])
def test_what_sets_in_later_is_not_seen_from_afar(later: float, fits: list[float]) -> None:
    experiment = Frames(sets_in(later))
    share, solution = look(experiment)
    # Far off on the frames after, for the frames before were fitted.
    assert ratio(solution) > TRACTABLE and solution.reason == "seen from before"
    assert first_window.at_other_scales(experiment, (share, solution), SPACING) == []


def test_other_recordings_are_seen_from_the_model_of_the_simplest(fits: list[float]) -> None:
    # The explained ones take no part in the misfit, be it the noise's own or more.
    for others in (1.0, 30.0):
        experiment = Frames(lambda _fitted, seen: 20.0 * seen, whole=("easy",), others=others)
        share, solution = look(experiment, added=("viscosity",))
        assert share == first_window.SEEN and fitted_share(solution.belief) == 1.0
        assert solution.reason == "seen from the simplest" and fits == []
    # Nothing to be seen in their first frames: windows as usual.
    experiment = Frames(lambda fitted, seen: sets_in(0.45)(fitted, seen) if fitted < 1 else 1.0 + 5.0 * (
        seen > 0.9), whole=("easy",), others=1.0)  # fmt: skip
    share, _ = look(experiment, added=("viscosity",))
    assert share == pytest.approx(0.475) and fits[0] == 0.25


def test_a_misfit_of_others_that_is_small_is_small_whatever_the_simplest_do(fits: list[float]) -> None:
    experiment = Frames(lambda _fitted, _seen: 3.0, whole=("easy",), others=30.0)
    assert look(experiment)[0] == 1.0


def test_forgetting_puts_materials_at_the_middle_of_their_priors() -> None:
    belief = plain_belief(2).with_parameter(KEY, prior_mean=float(np.log(2e5)), prior_std=1.0)
    belief = belief.with_effect("viscosity", {"eta": 3.0})
    found = first_window.with_materials_at_prior(belief)
    assert found[KEY].value == pytest.approx(2e5)
    # No prior, or no material: kept.
    assert found["part0.density"] == belief["part0.density"]
    assert found["viscosity.eta"].value == 3.0
    # Bounds about a scale that was found are not those of another one.
    narrow = about_its_scale(belief.with_parameter(KEY, value=1e7))
    assert narrow[KEY].lower == pytest.approx(1e7 / CONTRAST) and narrow[KEY].upper == 1e7 * CONTRAST
    assert narrow["part0.density"] == belief["part0.density"]
    assert narrow[KEY].lower > 2e5 and first_window.with_materials_at_prior(narrow)[KEY] == found[KEY]
    again = about_its_scale(first_window.with_materials_at_prior(narrow))
    assert again[KEY].lower == pytest.approx(2e5 / CONTRAST) and again[KEY].widest == narrow[KEY].widest
    # Never beyond those that it had from the start.
    stated = belief.with_parameter(KEY, value=2e5, lower=1e5, upper=5e5)
    assert (about_its_scale(stated)[KEY].lower, about_its_scale(stated)[KEY].upper) == (1e5, 5e5)
    kept = belief_from_document(json.loads(json.dumps(document_of_belief(narrow))))
    assert kept.parameters == narrow.parameters


# ---- on from a window -------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("share", "kind", "shares"),
    [
        (1.0, "smooth", []),
        (0.25, "smooth", [0.5, 1.0]),
        (0.16, "smooth", [0.32, 0.64, 1.0]),
        (0.55, "measurement", [1.0]),
        (0.25, "threshold", [0.5, 0.75, 1.0]),
        (0.1, "threshold", [0.2, 0.4, 0.7, 1.0]),
        (0.475, "threshold", [0.7375, 1.0]),
    ],
)
def test_a_motion_is_followed_from_the_window_to_all_frames(
    share: float, kind: str, shares: list[float]
) -> None:
    assert growing_shares(share, kind) == pytest.approx(shares)


# ---- what is tried ----------------------------------------------------------------------------
def ranking_of(*entries: RankedEffect, misfit: float = 10.0, decoy: float = 0.0) -> Ranking:
    """A ranking at a misfit [sigma] of 1000 rows."""
    return Ranking(entries, 1000.0 * misfit**2, 1000, None, None, decoy)


def names(entries: list[RankedEffect]) -> list[str]:
    return [entry.effect for entry in entries]


def test_only_what_is_significant_is_tried() -> None:
    good = entry_of("viscosity", 500.0)
    by_chance = entry_of("gravity", 400.0, p_value=2e-3)
    weak = entry_of("wind", 15.0)
    assert names(promising(ranking_of(good, by_chance, weak))) == ["viscosity"]
    assert promising(ranking_of(by_chance, weak)) == [] and promising(ranking_of()) == []


def test_so_many_are_begun_that_come_near_the_best() -> None:
    many = [entry_of(f"effect{k}", 1000.0 - k) for k in range(9)]
    assert promising(ranking_of(*many)) == many[: refits.BEGUN]
    few = [entry_of("viscosity", 1000.0), entry_of("gravity", 101.0), entry_of("wind", 99.0)]
    assert names(promising(ranking_of(*few))) == ["viscosity", "gravity"]


def test_each_kind_gets_a_hearing() -> None:
    many = [entry_of(f"effect{k}", 1000.0 - k) for k in range(9)]
    wall = entry_of("contact", 30.0, kind="threshold")
    fault = entry_of("time_offset", 19.0, kind="measurement")
    later = entry_of("plasticity", 29.0, kind="threshold")
    # The fault explains less than 2 % of what the best would.
    found = promising(ranking_of(*many, wall, later, fault))
    assert found == [*many[: refits.BEGUN], wall]
    assert promising(ranking_of(*many, wall, replace(fault, statistic=21.0)))[-1].effect == "time_offset"
    # One that is among the best already is not tried twice.
    assert names(promising(ranking_of(many[0], replace(wall, statistic=900.0)))) == ["effect0", "contact"]


def test_near_the_floor_only_what_explains_a_share_is_tried() -> None:
    # 1.5 sigma: 1250 of chi^2 beyond noise, of which 15 % are 187.5, 3 % 37.5.
    entries = [entry_of("viscosity", 189.0), entry_of("gravity", 186.0)]
    walls = [entry_of("contact", 39.0, kind="threshold"), entry_of("plasticity", 36.0, kind="threshold")]
    faults = [entry_of("time_offset", 189.0, kind="measurement")]
    found = promising(ranking_of(*entries, *walls, *faults, misfit=1.5))
    assert names(found) == ["viscosity", "contact", "time_offset"]
    # Where none does, the two that promise most; what explains less than an effect that does nothing is none.
    few = [entry_of(name, by) for name, by in (("viscosity", 90.0), ("gravity", 80.0), ("wind", 70.0))]
    assert names(promising(ranking_of(*few, misfit=1.5))) == ["viscosity", "gravity"]
    assert names(promising(ranking_of(*few, misfit=1.5, decoy=85.0))) == ["viscosity", "gravity"]
    assert names(promising(ranking_of(few[0], entry_of("gravity", 17.0), misfit=1.5, decoy=85.0))) == [
        "viscosity"
    ]
    # Nor what explains less than an effect that does nothing, unless it is near the best.
    entries = [entry_of("viscosity", 1200.0), entry_of("gravity", 250.0), entry_of("wind", 230.0)]
    assert len(promising(ranking_of(*entries, misfit=1.5))) == 3
    assert names(promising(ranking_of(*entries, misfit=1.5, decoy=700.0))) == ["viscosity", "gravity"]
    assert len(promising(ranking_of(*entries, misfit=1.5, decoy=220.0))) == 3
    # Far from the data predictions are poor judges.
    assert len(promising(ranking_of(*entries, misfit=2.1, decoy=700.0))) == 3


# ---- what is kept -----------------------------------------------------------------------------
def kept(
    monkeypatch: pytest.MonkeyPatch,
    best: Step,
    *rivals: Step,
    moved: Step | None = None,
    grid: float = SPACING,
    explained: bool = True,
) -> Step:
    """What `selected_model` keeps; grid: that the best one is brought to, explained there or not; moved: what
    a rival becomes on it."""
    asked: list[float] = []

    def refined(
        _experiment: object, steps: list[Step], _report: object, *, screening: bool, tied: bool
    ) -> Step:
        assert screening and len(steps) == 2
        return replace(steps[-1], spacing=grid) if grid != steps[-1].spacing else steps[-1]

    def on_grid(
        _experiment: object, step: Step, spacing: float, _report: object, *, hopeless: float, tangents: bool
    ) -> Step | None:
        assert not tangents  # a rival needs them only where it is kept
        asked.append(spacing)
        return moved

    monkeypatch.setattr(model_selection, "on_required_grid", refined)
    monkeypatch.setattr(model_selection, "on_grid", on_grid)
    found = selected_model(ALONE, [step_of(assessment_of(20.0))], best, rivals, None, screening=True)
    assert set(asked) <= {grid}
    return found


def model(name: str, excess: float, free: int) -> Step:
    return step_of(excess_of(excess), added=(name,), free=free)


def test_of_models_that_do_alike_the_one_with_fewest_parameters_is_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    best, rival = model("fibre", 0.10, 3), model("viscosity", 0.12, 2)
    found = kept(monkeypatch, replace(best, refits=("all",)), rival)
    assert (found.added, found.ties) == (("viscosity",), ("fibre",))
    assert found.refits == ("all",)
    # As many parameters: the closer one.
    found = kept(monkeypatch, best, replace(rival, belief=best.belief))
    assert (found.added, found.ties) == (("fibre",), ("viscosity",))


@pytest.mark.parametrize("more", [0, 1, 2])
def test_every_parameter_more_has_to_pay(more: int, monkeypatch: pytest.MonkeyPatch) -> None:
    best = model("fibre", 0.40, 3)
    limit = 0.40 / 0.8 + 0.02 * (1 + more)
    within, beyond = (model("viscosity", limit + side, 3 - more) for side in (-1e-3, 1e-3))
    found = kept(monkeypatch, best, within)
    assert {found.added[0], *found.ties} == {"fibre", "viscosity"}
    assert found.added == (("viscosity",) if more else ("fibre",))
    found = kept(monkeypatch, best, beyond)
    assert (found.added, found.ties) == (("fibre",), ())


def test_what_the_grid_excuses_is_not_beaten_by_what_fits_its_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Explained, for the grid has its share of what is left; the rival has more to bend and is not explained.
    excused = step_of(assessment_of(3.4, adequate=True), added=("air_drag",), free=2)
    bent = step_of(assessment_of(2.0), added=("wind",), free=5)
    found = kept(monkeypatch, excused, bent)
    assert (found.added, found.ties) == (("air_drag",), ("wind",))
    # A rival at the floor is another matter.
    found = kept(monkeypatch, excused, step_of(assessment_of(1.05), added=("wind",), free=5))
    assert found.added == ("wind",)
    # Both are excused: the one with less to bend, and of two alike the closer one.
    closer = step_of(assessment_of(1.5, adequate=True), added=("wind",), free=5)
    found = kept(monkeypatch, excused, closer)
    assert (found.added, found.ties) == (("air_drag",), ("wind",))
    found = kept(monkeypatch, excused, replace(closer, belief=excused.belief))
    assert (found.added, found.ties) == (("wind",), ())
    # Nor is one protected that is not explained.
    found = kept(monkeypatch, replace(excused, assessment=assessment_of(3.4)), bent)
    assert (found.added, found.ties) == (("wind",), ())


def test_a_rival_that_is_clearly_better_takes_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    # 0.8 x 0.5 - 0.02 = 0.38
    best, clearly = model("fibre", 0.50, 2), model("viscosity", 0.37, 2)
    found = kept(monkeypatch, best, model("wind", 0.49, 2), clearly)
    assert found.added == ("viscosity",)
    # What it beat is no tie unless it does alike: 0.37 / 0.8 + 0.02 = 0.4825.
    assert found.ties == ()
    found = kept(monkeypatch, best, model("wind", 0.48, 2), clearly)
    assert (found.added, found.ties) == (("viscosity",), ("wind",))


def test_where_none_explains_it_the_limit_of_fine_grids_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    # The first makes up for what this grid gets wrong, the second is right but for the grid.
    first = replace(model("tether", 1.4, 2), excess_beyond=2.1)
    second = replace(model("attached_mass", 1.8, 3), excess_beyond=0.4)
    found = kept(monkeypatch, first, second)
    assert (found.added, found.ties) == (("attached_mass",), ())
    # No limit is known of one of them, or one explains the motion as it is: what they leave here decides.
    for known in (replace(second, excess_beyond=None), replace(second, excess_beyond=2.2)):
        found = kept(monkeypatch, first, known)
        assert found.added == ("tether",)
    found = kept(monkeypatch, replace(first, assessment=assessment_of(1.05)), second)
    assert (found.added, found.ties) == (("tether",), ())


def test_what_takes_the_place_is_asked_on_the_grid_that_it_wants(monkeypatch: pytest.MonkeyPatch) -> None:
    fine = step_of(assessment_of(1.05), added=("attached_mass",), spacing=0.5 * SPACING)

    def required(_e: object, steps: list[Step], _r: object, **_: object) -> Step:
        return fine if steps[-1].added == fine.added else steps[-1]

    monkeypatch.setattr(model_selection, "on_required_grid", required)
    first = replace(model("tether", 1.4, 2), excess_beyond=2.1)
    second = replace(model("attached_mass", 1.8, 3), excess_beyond=0.4)
    found = selected_model(ALONE, [step_of(assessment_of(20.0))], first, [second], None, screening=True)
    assert (found.added, found.spacing) == (fine.added, fine.spacing)


def test_numbers_that_explain_far_more_are_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def refined(_e: object, steps: list[Step], _r: object, **_: object) -> Step:
        asked.append(steps[-1].added[0])
        return steps[-1]

    monkeypatch.setattr(model_selection, "on_required_grid", refined)
    first = step_of(assessment_of(20.0))
    still, wind = model("air_drag", 1.5, 2), model("wind", 0.05, 5)
    found = selected_model(ALONE, [first], wind, [still], None, screening=True)
    assert (found.added, found.ties, asked) == (("wind",), (), ["wind"])


@pytest.mark.parametrize("left", [0.06, 0.03])
def test_rivals_follow_to_a_grid_that_lent_tangents_reached(
    monkeypatch: pytest.MonkeyPatch, left: float
) -> None:
    """left: the rival's excess on the grid of the Jacobians, less what the grid changes."""
    went: list[tuple[str, float]] = []
    # So much do materials cost that are not the best ones.
    costs = {5e4: 9.0, 6e4: 1.0}

    class Problem:
        def evaluate(self, belief: Belief, *, jacobian: bool) -> SimpleNamespace:
            assert not jacobian
            return SimpleNamespace(cost=costs[belief[KEY].value])

    there = Problem()

    def corrected_coarse_problem(_experiment: object, best: Step) -> Problem:
        assert best.jacobian_spacing == 0.5 * SPACING
        return there

    def rival_on_coarse_grid(
        _experiment: object, problem: Problem, step: Step, best: Step, _report: object
    ) -> Step:
        assert problem is there
        went.append(("carried over", step.belief[KEY].value))
        spacings = {"spacing": best.spacing, "jacobian_spacing": best.jacobian_spacing}
        return replace(step, assessment=excess_of(left), **spacings)

    def fitted_by_coarse_jacobians(
        _experiment: object, step: Step, spacing: float, jacobian_spacing: float, _report: object
    ) -> Step:
        assert (spacing, jacobian_spacing) == (0.4 * SPACING, 0.5 * SPACING)
        went.append(("fitted", step.belief[KEY].value))
        return replace(step, assessment=excess_of(0.045))

    def on_required_grid(_experiment: object, steps: list[Step], *_: object, **__: object) -> Step:
        return replace(steps[-1], spacing=0.4 * SPACING, jacobian_spacing=0.5 * SPACING)

    def at(step: Step, young: float) -> Step:
        return replace(step, belief=step.belief.with_parameter(KEY, value=young))

    for function in (
        corrected_coarse_problem, rival_on_coarse_grid, fitted_by_coarse_jacobians, on_required_grid,
    ):  # fmt: skip
        monkeypatch.setattr(model_selection, function.__name__, function)
    best, rival = at(model("viscosity", 0.05, 2), 6e4), at(model("fibre", 0.06, 2), 5e4)
    first = [step_of(assessment_of(20.0))]
    found = selected_model(ALONE, first, best, [rival], None, screening=True)
    # It begins with the materials that the best one found there, where its own fit worse,
    assert went[0] == ("carried over", 6e4)
    if left > 0.05:
        assert len(went) == 1
        assert (found.added, found.ties) == (("viscosity",), ("fibre",))
    else:
        # What could take the best one's place is fitted there itself,
        assert went[1:] == [("fitted", 6e4)]
        assert (found.added, found.ties) == (("fibre",), ("viscosity",))
    # and with its own, where they fit better.
    costs[5e4] = 0.5
    went.clear()
    selected_model(ALONE, first, best, [rival], None, screening=True)
    assert went[0] == ("carried over", 5e4)


def test_rivals_are_compared_on_the_grid_of_the_best(monkeypatch: pytest.MonkeyPatch) -> None:
    best, rival = model("fibre", 0.10, 3), model("viscosity", 0.12, 2)
    fine = 0.5 * SPACING
    # The plainer one goes ahead, the other follows where that is explained.
    moved = replace(best, assessment=excess_of(0.11), spacing=fine)
    found = kept(monkeypatch, best, rival, moved=moved, grid=fine)
    assert (found.added, found.ties, found.spacing) == (("viscosity",), ("fibre",), fine)
    # One that cannot be simulated there is no rival.
    assert kept(monkeypatch, best, rival, moved=None, grid=fine).ties == ()
    # Where the best one is not explained on it, one may be that was behind on the coarse grid,
    far, little = replace(best, assessment=excess_of(3.1)), replace(rival, assessment=excess_of(3.0))
    assert kept(monkeypatch, little, far, moved=moved, grid=fine).added == ("fibre",)
    # but none that is far off.
    far, little = replace(best, assessment=excess_of(9.1)), replace(rival, assessment=excess_of(9.0))
    found = kept(monkeypatch, little, far, moved=moved, grid=fine)
    assert (found.added, found.ties) == (("viscosity",), ())


# ---- which refits are finished ----------------------------------------------------------------
@pytest.mark.parametrize(
    ("pays", "own", "bound"), [(True, 0.0, 400.0), (True, 2.0, 500.0), (False, 0.0, np.inf)]
)
def test_only_what_pays_sets_a_bound_for_others(
    pays: bool, own: float, bound: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """own: the grid's error [sigma], within which nothing is told apart."""
    rows = 100
    chi_squares = {"base_motion": 400.0, "relaxation": 700.0}
    bounds: dict[str, float] = {}

    def start_refit(_e: object, _b: object, entry: RankedEffect, *_: object, **__: object) -> Solution:
        return solution_of(plain_belief(), evaluation_of(chi_squares[entry.effect], rows))

    def finish_refit(
        _e: object,
        _b: object,
        _c: object,
        entry: RankedEffect,
        begun: Solution,
        *_: object,
        **options: object,
    ) -> object:
        bounds[entry.effect] = options["hopeless"]
        gain = GainInterval(1.0, 0.5, 1.5, 10) if pays else None
        refit = refit_of(gain=gain, chi_square=chi_squares[entry.effect], drop=1e4 if pays else 1.0)
        assert refit.pays is pays
        return refit

    monkeypatch.setattr(refits, "start_refit", start_refit)
    monkeypatch.setattr(finished_refits, "finish_refit", finish_refit)
    monkeypatch.setattr(finished_refits, "unabsorbed", lambda *_: own)
    entries = [entry_of(name, 1e4) for name in chi_squares]
    current = step_of(assessment_of(5.0))
    window = (1.0, solution_of(plain_belief(), evaluation_of(1e4, rows)))
    refits_of(ALONE, current, window, ranking_of(*entries), SPACING, None, lambda _text: None)
    assert bounds["base_motion"] == np.inf
    assert bounds["relaxation"] == pytest.approx(refits.ALIKE * bound)


@pytest.mark.parametrize(
    ("fifth", "worst", "followed"),
    [
        # as little beyond noise as rivals may leave, or as the best one and a quarter more
        (1.09, 1.0, True),
        (1.11, 1.0, False),
        # three times what the best one leaves, as long as none is at the noise; not for ever
        (1.59, 1.2, True),
        (1.61, 1.2, False),
    ],
)
def test_near_the_floor_more_are_brought_to_the_end(fifth: float, worst: float, followed: bool) -> None:
    """The first one leaves 0.05 of the noise's mean square, or 0.2 where none gets to the noise."""
    rows, first = 100, 1.05 if worst == 1.0 else 1.2
    left = [first, first + 0.01, first + 0.02, first + 0.03, fifth, fifth, fifth]
    begun = [
        (rows * value, entry_of("viscosity", 1e4), solution_of(plain_belief(), evaluation_of(rows * value)))
        for value in left
    ]
    gain = GainInterval(1.0, 0.5, 1.5, 10)
    finished = [refit_of(gain=gain, drop=1e4, assessment=assessment_of(worst))]
    assert finished_refits._worth_the_end(begun, 4, finished) is followed
    assert finished_refits._worth_the_end(begun, 6, finished) is (followed and worst == 1.0)


@pytest.mark.parametrize(
    ("left", "moves_to", "asked"),
    # Seven times as much beyond noise as the best one and less than that at its place; more there than rivals
    # may leave; more than six times what the best one leaves: no place is fitted.
    [(134, 104, True), (134, 140, False), (700, 104, False)],
)
def test_near_the_floor_an_effect_is_held_against_others_at_its_place(
    left: int, moves_to: int, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """100 rows, of which the others leave 5 to 8 too much and pay."""
    chi_squares = {"wind": 105, "fibre": 106, "gravity": 107, "air_drag": 108}
    chi_squares["attached_mass"] = left
    finished: list[str] = []
    heavy = plain_belief().with_effect("attached_mass", {"m": 1e-3}, {"place": [0.0, 0.0, 0.01]})

    def start_refit(_e: object, _b: object, entry: RankedEffect, *_: object, **__: object) -> Solution:
        belief = heavy if entry.effect == "attached_mass" else plain_belief()
        return solution_of(belief, evaluation_of(float(chi_squares[entry.effect]), 100))

    def finish_refit(
        _e: object, _b: object, _c: object, entry: RankedEffect, *_: object, **__: object
    ) -> Refit:
        finished.append(entry.effect)
        return refit_of(gain=GainInterval(1.0, 0.5, 1.5, 10), drop=1e4, assessment=assessment_of(1.2))

    def relocated(_problem: object, fit: Solution, **_: object) -> Solution:
        assert "attached_mass" in fit.belief.effects
        return replace(fit, evaluation=evaluation_of(float(moves_to), 100))

    monkeypatch.setattr(refits, "start_refit", start_refit)
    monkeypatch.setattr(finished_refits, "finish_refit", finish_refit)
    monkeypatch.setattr(window_continuation, "relocated", relocated)
    monkeypatch.setattr(finished_refits, "unabsorbed", lambda *_: 0.0)
    entries = [entry_of(name, 1e4) for name in chi_squares]
    window = (1.0, solution_of(plain_belief(), evaluation_of(1e4)))
    alone = SimpleNamespace(settings=ALONE.settings, window=lambda *_: None)
    refits_of(
        alone, step_of(assessment_of(5.0)), window, ranking_of(*entries, misfit=1.5), SPACING, None,
        lambda _text: None,
    )  # fmt: skip
    assert finished == [*["attached_mass"] * asked, "wind", "fibre", "gravity", "air_drag"]


@pytest.mark.parametrize("pays", [True, False])
def test_those_behind_on_a_short_window_follow_where_none_in_front_pays(
    pays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first two do alike on the window, the others leave more of it."""
    front = 2
    chi_squares = {"frame_drift": 100.0, "wind": 120.0, "base_motion": 220.0, "tether": 400.0, "fibre": 500.0}
    chi_squares["gravity"] = 600.0
    brought: list[list[str]] = []

    def start_refit(_e: object, _b: object, entry: RankedEffect, *_: object, **__: object) -> Solution:
        return solution_of(plain_belief(), evaluation_of(chi_squares[entry.effect]))

    def onward(_e: object, _share: float, begun: list[tuple], *_: object) -> list[tuple]:
        brought.append([entry.effect for _, entry, _ in begun])
        return begun

    def finish_refit(
        _e: object, _b: object, _c: object, entry: RankedEffect, *_: object, **__: object
    ) -> SimpleNamespace:
        good = pays or entry.effect == "base_motion"
        return SimpleNamespace(entry=entry, pays=good, may_pay=False, assessment=assessment_of(2.0))

    for module, function in ((refits, start_refit), (finished_refits, finish_refit)):
        monkeypatch.setattr(module, function.__name__, function)
    monkeypatch.setattr(refits, "continued_to_all_frames", onward)
    monkeypatch.setattr(finished_refits, "_hopeless", lambda *_: np.inf)
    entries = [entry_of(name, 1e4) for name in chi_squares]
    window = (0.25, solution_of(plain_belief(), evaluation_of(1e6)))
    ranking = ranking_of(*entries, misfit=10.0)
    said: list[str] = []
    found = refits_of(ALONE, step_of(assessment_of(5.0)), window, ranking, SPACING, None, said.append)
    begun = [line.split(",")[0] for line in said if line.startswith("refits begun")]
    assert begun == ["refits begun: 33% done", "refits begun: 67% done"]
    order = list(chi_squares)
    assert brought == [order[:front], *([] if pays else [order[front : front + 3]])]
    assert [r.entry.effect for r in found if r.pays][0] == ("frame_drift" if pays else "base_motion")


@pytest.mark.parametrize("pays", [True, False])
def test_what_promised_little_is_begun_where_what_promised_more_does_not_pay(
    pays: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A threshold leads on a strip whose drag had bent the materials: it scored a tenth of that."""
    asked: list[str] = []

    def start_refit(_e: object, _b: object, entry: RankedEffect, *_: object, **__: object) -> Solution:
        asked.append(entry.effect)
        left = 1800.0 if entry.effect == "plasticity" else 1200.0
        return solution_of(plain_belief(), evaluation_of(left, 1137))

    def finish_refit(
        _e: object, _b: object, _c: object, entry: RankedEffect, *_: object, **__: object
    ) -> SimpleNamespace:
        good = pays or entry.effect != "plasticity"
        return SimpleNamespace(entry=entry, pays=good, may_pay=False, assessment=assessment_of(2.0))

    monkeypatch.setattr(refits, "start_refit", start_refit)
    monkeypatch.setattr(finished_refits, "finish_refit", finish_refit)
    monkeypatch.setattr(finished_refits, "unabsorbed", lambda *_: 0.0)
    monkeypatch.setattr(finished_refits, "_hopeless", lambda *_: np.inf)
    entries = [
        entry_of("plasticity", 1055.0, kind="threshold"), entry_of("air_drag", 367.0),
        entry_of("gravity", 346.0), entry_of("fibre", 15.0),
    ]  # fmt: skip
    ranking = replace(ranking_of(*entries), chi_square=3825.0, rows=1137)
    window = (1.0, solution_of(plain_belief(), evaluation_of(3825.0, 1137)))
    fates: dict[str, str] = {}
    found = refits_of(
        ALONE, step_of(assessment_of(5.0)), window, ranking, SPACING, None, lambda _text: None, fates=fates
    )
    assert asked == (["plasticity"] if pays else ["plasticity", "air_drag", "gravity"])
    assert any(r.entry.effect == "air_drag" and r.pays for r in found) is not pays
    assert "noise" in fates["fibre"]


@pytest.mark.parametrize(("misfit", "pays", "asked"), [(1.5, True, 1), (2.5, True, 2), (1.5, False, 2)])
def test_near_the_floor_only_the_leaders_are_brought_to_the_end(
    misfit: float, pays: bool, asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second leaves 1.4 times as much as the first after the iterations that a refit is begun with."""
    chi_squares = {"base_motion": 400.0, "tether": 560.0}
    finished: list[str] = []

    def start_refit(_e: object, _b: object, entry: RankedEffect, *_: object, **options: object) -> Solution:
        assert options["iterations"] == (refits.FIRST_NEAR if misfit < refits.LINEAR else refits.FIRST)
        return solution_of(plain_belief(), evaluation_of(chi_squares[entry.effect], 100))

    def finish_refit(
        _e: object, _b: object, _c: object, entry: RankedEffect, *_: object, **__: object
    ) -> object:
        finished.append(entry.effect)
        gain = GainInterval(1.0, 0.5, 1.5, 10) if pays else None
        return refit_of(gain=gain, chi_square=chi_squares[entry.effect], drop=1e4 if pays else 1.0)

    monkeypatch.setattr(refits, "start_refit", start_refit)
    monkeypatch.setattr(finished_refits, "finish_refit", finish_refit)
    monkeypatch.setattr(finished_refits, "unabsorbed", lambda *_: 0.0)
    entries = [entry_of(name, 1e4) for name in chi_squares]
    window = (1.0, solution_of(plain_belief(), evaluation_of(1e4)))
    ranking = ranking_of(*entries, misfit=misfit)
    refits_of(ALONE, step_of(assessment_of(5.0)), window, ranking, SPACING, None, lambda _text: None)
    assert len(finished) == asked


@pytest.mark.parametrize(("misfit", "asked"), [(1.5, 4), (2.5, 5)])
def test_near_the_floor_those_after_the_third_are_held_by_what_they_leave_beyond_it(
    misfit: float, asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """100 rows: beyond them the best leaves 20, the fourth 24, the fifth 26, within a quarter of 120; all get
    to the noise in the end."""
    chi_squares = {"tether": 120, "wind": 121, "fibre": 122, "gravity": 124, "air_drag": 126}
    finished: list[str] = []

    def start_refit(_e: object, _b: object, entry: RankedEffect, *_: object, **__: object) -> Solution:
        return solution_of(plain_belief(), evaluation_of(float(chi_squares[entry.effect]), 100))

    def finish_refit(
        _e: object, _b: object, _c: object, entry: RankedEffect, *_: object, **__: object
    ) -> Refit:
        finished.append(entry.effect)
        return refit_of(gain=GainInterval(1.0, 0.5, 1.5, 10), drop=1e4)

    monkeypatch.setattr(refits, "start_refit", start_refit)
    monkeypatch.setattr(finished_refits, "finish_refit", finish_refit)
    monkeypatch.setattr(finished_refits, "unabsorbed", lambda *_: 0.0)
    entries = [entry_of(name, 1e4) for name in chi_squares]
    window = (1.0, solution_of(plain_belief(), evaluation_of(1e4)))
    ranking = ranking_of(*entries, misfit=misfit)
    refits_of(ALONE, step_of(assessment_of(5.0)), window, ranking, SPACING, None, lambda _text: None)
    assert len(finished) == asked


def test_what_cannot_come_near_the_best_is_not_begun(monkeypatch: pytest.MonkeyPatch) -> None:
    begun: list[str] = []

    def start_refit(_e: object, _b: object, entry: RankedEffect, *_: object, **__: object) -> None:
        begun.append(entry.effect)
        return solution_of(plain_belief(), evaluation_of(2e3)) if entry.effect == "air_drag" else None

    monkeypatch.setattr(refits, "start_refit", start_refit)
    monkeypatch.setattr(finished_refits, "finish_refit", lambda *_, **__: None)
    near = (1e4 - refits.ALIKE * 2e3) / refits.BEYOND_TANGENTS
    entries = [
        entry_of("air_drag", 6e3), entry_of("fibre", near + 1.0), entry_of("tether", near - 1.0),
        entry_of("contact", near - 2.0, kind="threshold"), entry_of("frame_drift", 1.2e3, kind="measurement"),
    ]  # fmt: skip
    window = (1.0, solution_of(plain_belief(), evaluation_of(1e4)))

    def begun_at(misfit: float) -> list[str]:
        begun.clear()
        ranking = replace(ranking_of(*entries, misfit=misfit), chi_square=1e4)
        ranking = replace(ranking, rows=round(1e4 / misfit**2))
        step = step_of(assessment_of(5.0))
        refits_of(ALONE, step, window, ranking, SPACING, None, lambda _text: None, onward=False)
        return list(begun)

    assert begun_at(3.9) == ["air_drag", "fibre", "contact"]
    # Far from the data the tangents tell too little.
    assert begun_at(4.1) == ["air_drag", "fibre", "tether", "contact", "frame_drift"]


@pytest.mark.parametrize("afar", [True, False])
def test_from_afar_no_first_iteration_says_who_leads(afar: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    chi_squares = {"gravity": 800.0, "wind": 400.0, "fibre": 500.0}
    bounds: list[float] = []
    allowed: list[tuple[int, float]] = []

    def start_refit(
        _e: object,
        before: Solution,
        entry: RankedEffect,
        *_: object,
        hopeless: float,
        iterations: int,
        accuracy: float,
        **__: object,
    ) -> Solution:
        bounds.append(hopeless)
        allowed.append((iterations, accuracy))
        return solution_of(before.belief, evaluation_of(chi_squares[entry.effect]))

    placed: list[tuple[int, bool]] = []

    def at_their_places(_e: object, begun: list[tuple], *_: object, anywhere: bool) -> list[tuple]:
        placed.append((len(begun), anywhere))
        return begun

    monkeypatch.setattr(refits, "start_refit", start_refit)
    monkeypatch.setattr(finished_refits, "finish_refit", lambda *_, **__: None)
    monkeypatch.setattr(refits, "with_places_fitted", at_their_places)
    lent: list[tuple[int, int, float]] = []

    def with_lent(_e: object, begun: list, *_: object, iterations: int, accuracy: float) -> list:
        lent.append((len(begun), iterations, accuracy))
        return begun

    monkeypatch.setattr(refits, "restarted_from_best_materials", with_lent)
    generator = np.random.default_rng(0)
    first = 1.0, solution_of(plain_belief(), evaluation_of(2e4))
    ranking = ranking_of(*(entry_of(name, 1e4) for name in chi_squares))
    refits_of(
        ALONE, step_of(assessment_of(9.0)), first, ranking, SPACING, generator, lambda _text: None, afar=afar
    )
    assert bounds == ([np.inf] * 3 if afar else [np.inf, np.inf, refits.HOPELESS * 400.0])
    far, near = (refits.FIRST_AFAR, refits.ACCURACY_AFAR), (refits.FIRST, refits.ACCURACY)
    assert allowed == [far if afar else near] * 3
    assert placed == [(3, afar)] and lent == ([(3, *far)] if afar else [])


@pytest.mark.parametrize(("best", "behind"), [(1200.0, False), (1100.0, True)])
def test_less_is_hoped_for_where_one_is_at_the_noise(best: float, behind: bool) -> None:
    """3 sigma of 1000 rows; an effect that promises 3000 has to bring nearly three times as much."""
    ranking = replace(ranking_of(), chi_square=1e4, rows=1000)
    begun = [begun_at(best, 9e3)]
    assert refits._far_behind(entry_of("gravity", 3e3), ranking, begun) is behind
    assert not refits._far_behind(entry_of("gravity", 4.5e3), ranking, begun)


def begun_at(
    chi_square: float, promised: float, kind: str = "smooth"
) -> tuple[float, RankedEffect, Solution]:
    """A refit that was begun: what it left, and what its tangents had promised to take."""
    entry = entry_of("mass_damping", promised, kind=kind)
    return chi_square, entry, solution_of(plain_belief(), evaluation_of(chi_square))


@pytest.mark.parametrize(
    ("promised", "left", "kind", "behind"),
    [
        # 10000 of which 1300 were promised, 1100 left: nearly seven times as much, as of a strip with a mass
        # at its tip whose materials had made up for it
        (1.3e3, 1100.0, "smooth", False),
        # whether it leads or not;
        (1.3e3, 1600.0, "smooth", False),
        # not where that one brought about what it promised,
        (7e3, 1100.0, "smooth", True),
        # nor where trials promised.
        (1.3e3, 1100.0, "threshold", True),
    ],
)
def test_promises_strike_nothing_off_where_one_was_kept_many_times_over(
    promised: float, left: float, kind: str, behind: bool
) -> None:
    ranking = replace(ranking_of(), chi_square=1e4, rows=1000)
    begun = [begun_at(1100.0, 9e3), begun_at(left, promised, kind)]
    assert refits._far_behind(entry_of("attached_mass", 1.0e3), ranking, begun) is behind


# ---- which effects are kept -------------------------------------------------------------------
@pytest.mark.parametrize(
    ("left", "adequate", "kept"), [(0.75, False, True), (0.85, False, False), (0.85, True, True)]
)
def test_what_explains_too_little_is_not_kept(
    left: float, adequate: bool, kept: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """left: share of the excess that the best effect leaves."""
    first = step_of(excess_of(10.0))
    after = excess_of(10.0 * left)
    after = replace(after, adequate=adequate)
    found = step_of(after, added=("fibre",), free=1)
    pays = SimpleNamespace(pays=True, surprising=False, entry=SimpleNamespace(effect="fibre"))
    rounds: list[int] = []

    def refits_of(*_: object, **__: object) -> list[object]:
        rounds.append(1)
        return [pays] if len(rounds) == 1 else []

    whole = (1.0, first.solution)
    patches: dict[str, Callable] = {
        "candidate_rows": lambda *_: (), "undetermined": lambda *_: (), "bounded": lambda step, _e: step,
        "ranked_on_window": lambda *_, **__: (whole, False, ranking_of()), "refits_of": refits_of,
        "best_and_rivals": lambda refits: (refits[0], []),
        "step_of": lambda *_: found, "selected_model": lambda *_, **__: found,
        "with_effects_pruned": lambda _e, step, *_: step,
        "reconciled": lambda _e, step, _r: step, "on_required_grid": lambda _e, steps, *_, **__: steps[-1],
        "mask_outliers": lambda *_: 0, "sequences_without_loads": lambda _e: (),
        "converged_fit": lambda _e, step, _r: step, "finely": lambda _e, step, _r: step,
        "with_budget": lambda _e, step, _r, **_: step, "screening_spacing": lambda _c: SPACING,
    }  # fmt: skip
    for name, function in patches.items():
        monkeypatch.setattr(discovery, name, function)
    said: list[str] = []
    loop = discovery.discover_effects(
        UNSEEN, plain_belief(), SPACING, start=[first], report=said.append
    )
    assert [step.added for step in loop.steps] == ([(), ("fibre",)] if kept else [()])
    assert ("fibre: explains too little of what is left" in said) is not kept
    assert loop.verdict == ("missing" if adequate else "unknown")


@pytest.mark.parametrize(
    ("added", "excesses", "goes_on"),
    [
        ([(), ("gravity",)], (10.0, 7.0), True),
        ([(), ("gravity",), ("wind",)], (10.0, 5.0, 2.4), True),
        ([(), ("gravity",), ("wind",)], (10.0, 5.0, 2.6), False),
        # bad tracks are no effect
        ([(), ("marker_outliers",), ("wind",)], (10.0, 9.0, 7.0), True),
        ([(), ("wind",), ("marker_outliers",)], (10.0, 9.0, 7.0), True),
    ],
)
def test_a_second_effect_that_leaves_most_is_not_followed_by_a_third(
    added: list[tuple[str, ...]],
    excesses: tuple[float, ...],
    goes_on: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps = [step_of(excess_of(left), added=name) for name, left in zip(added, excesses, strict=True)]
    looked: list[int] = []

    def ranked(*_: object, **__: object) -> tuple[tuple[float, Solution], bool, Ranking]:
        looked.append(1)
        return (1.0, steps[-1].solution), False, ranking_of()

    monkeypatch.setattr(discovery, "ranked_on_window", ranked)
    monkeypatch.setattr(discovery, "refits_of", lambda *_, **__: [])
    monkeypatch.setattr(discovery, "on_required_grid", lambda _e, steps, *_, **__: steps[-1])
    monkeypatch.setattr(discovery, "reconciled", lambda _e, step, _r: step)
    monkeypatch.setattr(discovery, "mask_outliers", lambda *_: 0)
    monkeypatch.setattr(discovery, "sequences_without_loads", lambda _e: ())
    monkeypatch.setattr(discovery, "candidate_rows", lambda *_: ())
    monkeypatch.setattr(discovery, "undetermined", lambda *_: ())
    monkeypatch.setattr(discovery, "bounded", lambda step, _e: step)
    # A loop that is resumed stops where it would have.
    found = discovery.discover_effects(UNSEEN, plain_belief(), SPACING, start=steps)
    assert found.verdict == "unknown" and len(looked) == goes_on


@pytest.mark.parametrize(
    ("left", "explained", "loads", "asked"),
    [
        (4.0, False, (), True),
        (6.0, False, (), False),
        # what is explained may have an effect too many, and loads are found one after the other
        (6.0, True, (), True),
        (6.0, False, ("a",), True),
    ],
)
def test_a_model_that_ends_the_loop_unexplained_is_not_pruned(
    left: float, explained: bool, loads: tuple[str, ...], asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second effect leaves this much of 10."""
    steps = [step_of(excess_of(20.0)), step_of(excess_of(10.0), added=("gravity",))]
    last = step_of(replace(excess_of(left), adequate=explained), added=("wind",))
    pruned: list[str] = []
    pays = SimpleNamespace(pays=True, surprising=False, entry=SimpleNamespace(effect="wind"))
    rounds = iter([[pays]])
    patches: dict[str, Callable] = {
        "candidate_rows": lambda *_: (), "undetermined": lambda *_: (), "bounded": lambda step, _e: step,
        "ranked_on_window": lambda *_, **__: ((1.0, steps[-1].solution), False, ranking_of()),
        "refits_of": lambda *_, **__: next(rounds, []),
        "best_and_rivals": lambda refits: (refits[0], []), "step_of": lambda *_: last,
        "selected_model": lambda *_, **__: last, "sequences_without_loads": lambda _e: loads,
        "with_effects_pruned": lambda _e, step, *_: pruned.append(step.added[0]) or step,
        "reconciled": lambda _e, step, _r: step, "on_required_grid": lambda _e, steps, *_, **__: steps[-1],
        "mask_outliers": lambda *_: 0, "converged_fit": lambda _e, step, _r: step,
        "finely": lambda _e, step, _r: step, "with_budget": lambda _e, step, _r, **_: step,
        "screening_spacing": lambda _c: SPACING,
        "with_effects_exchanged": lambda *_, **__: None, "with_simpler_effects": lambda _e, step, _r: step,
        "explains": lambda *_: False,
    }  # fmt: skip
    for name, function in patches.items():
        monkeypatch.setattr(discovery, name, function)
    discovery.discover_effects(UNSEEN, plain_belief(), SPACING, start=steps)
    assert pruned == (["wind"] if asked else [])


# ---- a loop that was stopped ------------------------------------------------------------------
@pytest.mark.parametrize(
    ("added", "asked"), [([()], 1), ([(), ("marker_outliers",)], 1), ([(), ("viscosity",)], 0)]
)
def test_a_step_that_was_kept_is_not_asked_again_for_its_grid(
    added: list[tuple[str, ...]], asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    went = []

    def refined(_experiment: object, steps: list[Step], *_: object, **__: object) -> Step:
        went.append(steps[-1])
        return steps[-1]

    done = assessment_of(1.0, adequate=True)
    steps = [replace(step_of(done, added=names), warnings=(f"of {names}",)) for names in added]
    monkeypatch.setattr(discovery, "on_required_grid", refined)
    monkeypatch.setattr(discovery, "converged_fit", lambda _e, step, _r: step)
    monkeypatch.setattr(discovery, "finely", lambda _e, step, _r: step)
    monkeypatch.setattr(discovery, "with_budget", lambda _e, step, _r, **_: step)
    monkeypatch.setattr(discovery, "with_tracks_readmitted", lambda _e, step, _r: step)
    monkeypatch.setattr(discovery, "screening_spacing", lambda _capture: SPACING)
    monkeypatch.setattr(discovery, "sequences_without_loads", lambda _experiment: ())
    monkeypatch.setattr(discovery, "candidate_rows", lambda *_: ())
    monkeypatch.setattr(discovery, "undetermined", lambda *_: ())
    monkeypatch.setattr(discovery, "bounded", lambda step, _e: step)
    experiment = UNSEEN
    found = discovery.discover_effects(experiment, plain_belief(), SPACING, start=steps, names=())
    assert len(went) == asked
    assert found.steps == tuple(steps)
    assert found.warnings == tuple(f"of {names}" for names in added)


@pytest.mark.parametrize(("worst", "effects"), [(1.0, ("gravity", "wind")), (1.2, ("viscosity", "gravity"))])
def test_an_exchange_that_explains_no_longer_is_not_made(
    worst: float, effects: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    near = assessment_of(1.06)
    steps = [step_of(near, added=names) for names in ((), ("viscosity",), ("gravity",))]
    other = [replace(step_of(assessment_of(worst), added=("wind",)), dropped=("viscosity",))]
    monkeypatch.setattr(discovery, "with_effects_exchanged", lambda *_, **__: other.pop() if other else None)
    for name in ("converged_fit", "finely", "reconciled"):
        monkeypatch.setattr(discovery, name, lambda _e, step, _r: step)
    monkeypatch.setattr(discovery, "with_budget", lambda _e, step, _r, **_: step)
    monkeypatch.setattr(discovery, "screening_spacing", lambda _capture: SPACING)
    monkeypatch.setattr(discovery, "sequences_without_loads", lambda _experiment: ())
    monkeypatch.setattr(discovery, "candidate_rows", lambda *_: ())
    monkeypatch.setattr(discovery, "undetermined", lambda *_: ())
    monkeypatch.setattr(discovery, "bounded", lambda step, _e: step)
    monkeypatch.setattr(discovery, "mask_outliers", lambda *_: 0)
    experiment = UNSEEN
    found = discovery.discover_effects(experiment, plain_belief(), SPACING, start=steps, names=())
    assert (found.verdict, found.effects) == ("missing", effects)


# ---- what is concluded ------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("added", "ratio", "adequate", "verdict", "effects"),
    [
        ([()], 1.0, True, "adequate", ()),
        # without an effect the practical floor is no excuse
        ([()], 1.14, False, "unknown", ()),
        ([(), ("viscosity",)], 1.09, False, "missing", ("viscosity",)),
        ([(), ("viscosity",), ("gravity",)], 1.0, True, "missing", ("viscosity", "gravity")),
        ([(), ("time_offset",)], 1.0, True, "measurement", ("time_offset",)),
        ([(), ("marker_outliers",), ("viscosity",)], 1.0, True, "missing", ("marker_outliers", "viscosity")),
        # however much it helped
        ([(), ("viscosity",)], 1.16, False, "unknown", ()),
    ],
)
def test_the_verdict(
    added: list[tuple[str, ...]], ratio: float, adequate: bool, verdict: str, effects: tuple[str, ...]
) -> None:
    steps = [step_of(assessment_of(9.0), added=names) for names in added]
    steps[-1] = replace(steps[-1], assessment=assessment_of(ratio, adequate=adequate))
    found = conclusion.conclude(steps, [], ["a warning"])
    assert (found.verdict, found.effects) == (verdict, effects)
    assert found.steps == tuple(steps) and found.warnings == ("a warning",)


@pytest.mark.parametrize(
    ("added", "ratio", "verdict", "effects"),
    [
        ([()], 1.0, "measurement", ("label_swaps", "zero_gaps")),
        ([(), ("viscosity",)], 1.0, "missing", ("viscosity", "label_swaps", "zero_gaps")),
        ([()], 1.5, "unknown", ()),
    ],
)
def test_faults_that_the_tracks_show_are_concluded(
    added: list[tuple[str, ...]], ratio: float, verdict: str, effects: tuple[str, ...]
) -> None:
    steps = [step_of(assessment_of(9.0), added=names) for names in added]
    steps[-1] = replace(steps[-1], assessment=assessment_of(ratio, adequate=ratio < 1.1))
    swaps, gaps = Finding("label_swaps", "2 and 3"), Finding("zero_gaps", "5")
    found = conclusion.conclude(steps, [], [], {"a": [swaps], "b": [swaps, gaps]})
    assert (found.verdict, found.effects) == (verdict, effects)
    assert found.warnings == ("'a': label_swaps: 2 and 3", "'b': label_swaps: 2 and 3", "'b': zero_gaps: 5")


def test_a_jitter_of_all_markers_beyond_the_stated_noise_is_a_fault() -> None:
    jitter = replace(NoiseModel.white(2e-4, "stated"), common_sigma=np.array([0.0, 4e-4, 0.0]))
    for sigma, named in ((2e-4, ["common_shake"]), (4e-4, [])):
        markers = Markers(np.zeros((3, 2, 3)), np.zeros((2, 3)), sigma)
        capture = SimpleNamespace(sequences=(SimpleNamespace(name="a", markers=markers),))
        observation = Observation(markers.position, jitter, np.ones(2))
        found = seen_faults(SimpleNamespace(observations={"a": observation}, capture=capture))
        assert fault_names(found) == named


def test_a_noise_that_nothing_reaches_is_said_to_be_too_large() -> None:
    for ratio, said in ((0.1, True), (0.7, False)):
        found = conclusion.conclude([step_of(assessment_of(ratio, adequate=True), added=())], [], [])
        assert found.verdict == "adequate"
        assert [("sigma may be 10 times too large" in line) for line in found.warnings] == [True] * said
