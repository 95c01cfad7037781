"""When an effect that was refitted pays, and when a refit is given up."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SPACING, entry_of, recorded, refit_of
from mphygs.capture.format import Capture
from mphygs.compare.assess import Compared
from mphygs.compare.autoregression import Autoregression
from mphygs.diagnose.held_out import GainInterval
from mphygs.diagnose.rank import rank
from mphygs.diagnose.ranking import RankedEffect
from mphygs.diagnose.wall import Plane
from mphygs.extend import refit, refit_beginning
from mphygs.extend.known_slopes import _evaluated, approached_from
from mphygs.extend.refit import finish_refit, unseen_gain
from mphygs.extend.refit_beginning import start_refit
from mphygs.fit import levenberg_marquardt
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.problem import Evaluation
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Prediction, Predictor, Settings
from variants_example import with_wall

FREE = ("part0.youngs_modulus",)
ETA = 40.0


# ---- whether it pays --------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("low", "gain", "left", "pays"),
    [
        # the whole interval above zero
        (0.1, 5.0, 0.9, True),
        # a gain that no interval is sure of: only where most of the misfit is explained
        (-3.0, 5.0, 0.20, True),
        (-3.0, 5.0, 0.30, False),
        # no gain on unseen frames, however much of the fitted ones is explained
        (-3.0, -1.0, 0.01, False),
        (-3.0, 0.0, 0.01, False),
    ],
)
def test_an_effect_pays_on_unseen_frames(low: float, gain: float, left: float, pays: bool) -> None:
    chi_square, before = 1000.0 * left, 1000.0
    found = refit_of(gain=GainInterval(gain, low, 9.0, 6), chi_square=chi_square, drop=before - chi_square)
    assert found.pays is pays


def test_without_unseen_frames_the_drop_decides() -> None:
    assert refit_of(gain=None, drop=21.0).pays and not refit_of(gain=None, drop=20.0).pays


def test_what_sets_in_and_explains_the_fitted_frames_may_pay() -> None:
    worse = GainInterval(-1.0, -3.0, 9.0, 6)
    for left, asked in ((0.05, True), (0.15, False)):
        found = refit_of(gain=worse, chi_square=1000.0 * left, drop=1000.0 * (1.0 - left))
        assert not found.pays and not found.may_pay  # viscosity does not set in
        wall = replace(found, entry=replace(found.entry, kind="threshold"))
        assert wall.may_pay is asked and not wall.pays
    assert not replace(wall, actual_drop=-1.0).may_pay


def test_a_drop_unlike_the_predicted_one_surprises() -> None:
    for drop, surprising in ((49.0, True), (51.0, False), (199.0, False), (201.0, True)):
        assert refit_of(gain=None, statistic=100.0, drop=drop).surprising is surprising


# ---- which recordings judge -------------------------------------------------------------------
def test_what_only_some_recordings_have_is_judged_by_those() -> None:
    belief = bar_belief(bar_capture())
    settings = {"place": [0.05, 0.01, 0.01], "sequences": ["b", "c"]}
    heavy = belief.with_effect("attached_mass", {"m": 1e-3}, settings).with_effect("viscosity")
    compared = dict.fromkeys("abc")
    assert list(refit._in_scope(compared, heavy, "attached_mass")) == ["b", "c"]
    assert refit._in_scope(compared, heavy, "viscosity") == compared
    # A fault that is no term of the model is one of all.
    assert refit._in_scope(compared, heavy, "marker_outliers") == compared


def test_only_a_wall_brings_materials_of_its_own() -> None:
    belief = bar_belief(bar_capture(), youngs_modulus=6e4, free=FREE).with_effect("viscosity", {"eta": 5.0})
    plane = Plane(np.array([0.0, 0.0, 1.0]), -0.01)
    soft = belief.with_parameter(FREE[0], value=2e4)
    for kind, kept in (("threshold", 2e4), ("smooth", 6e4)):
        entry = entry_of("contact", 100.0, kind=kind)
        start = refit_beginning._scaled(entry, with_wall(soft, plane), belief, 1.0)
        assert start[FREE[0]].value == pytest.approx(kept)
        # What else the model has stays as it is, linear or not.
        assert start["viscosity.eta"].log == belief["viscosity.eta"].log
        assert start["contact.d"].value == pytest.approx(-0.01)


# ---- a bar that lacks viscosity ---------------------------------------------------------------
@cache
def scene() -> tuple[Experiment, Solution, RankedEffect, Capture]:
    """A viscous bar, the elastic model fitted to it, and what the ranking would say of viscosity."""
    capture = bar_capture(frames=40, fps=100.0, fit=(0, 24))
    sequence = replace(capture.sequence("a"), predict=(24, 40))
    capture = replace(capture, sequences=(sequence,))
    plain = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    capture = recorded(capture, plain.with_effect("viscosity", {"eta": ETA}))
    experiment = Experiment.of(capture, Settings(SPACING, workers=1))
    before = minimise(experiment.problem(SPACING), plain)
    start = before.belief.with_effect("viscosity", {"eta": 0.15 * ETA})
    return experiment, before, entry_of("viscosity", 1000.0, start=start), capture


def begun(
    *, hopeless: float = math.inf, iterations: int = 4, entry: RankedEffect | None = None, share: float = 1.0
) -> tuple[Solution | None, list[str]]:
    experiment, before, usual, _ = scene()
    said: list[str] = []
    found = start_refit(
        experiment, before, entry or usual, SPACING,
        share=share, iterations=iterations, hopeless=hopeless, report=said.append,
    )  # fmt: skip
    return found, said


@pytest.mark.parametrize(("estimate", "strength"), [(0.4, 2.0), (1.0, 1.0), (2.5, 0.5)])
def test_a_refit_begins_at_the_strength_that_fits_best(
    estimate: float, strength: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    started = []

    def first(_problem: object, start: Belief, **_: object) -> None:
        started.append(start["viscosity.eta"].value)
        raise SimulationError("only the start is asked for")

    monkeypatch.setattr(refit_beginning, "approached_from", lambda _problem, _before, start: start)
    monkeypatch.setattr(refit_beginning, "minimise", first)
    start = scene()[1].belief.with_effect("viscosity", {"eta": estimate * ETA})
    assert begun(entry=entry_of("viscosity", 1000.0, start=start)) == (None, [])
    assert started == [pytest.approx(strength * estimate * ETA)]


@pytest.mark.parametrize(
    ("costs", "asked"),
    [
        # goes on while an iteration leaves less than 0.7, four times at most
        ([100.0, 60.0, 30.0, 20.0, 15.0], 3),
        ([100.0, 60.0, 30.0, 15.0, 7.0, 3.0, 1.0, 0.4], 4),
        ([100.0, 90.0, 40.0], 0),
        # it cannot be simulated farther
        ([100.0, 60.0, 30.0], 2),
    ],
)
def test_a_refit_that_still_falls_goes_on(
    costs: list[float], asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refit_beginning, "promise", lambda *_: 0.0)
    _, before, usual, _ = scene()
    evaluation, left, seen = before.evaluation, costs[1:], []

    def further(_problem: object, belief: Belief, *, iterations: int, **_: object) -> Solution:
        seen.append(iterations)
        if not left:
            raise SimulationError("no farther")
        last, now = costs[-len(left) - 1], left.pop(0)
        return Solution(belief, evaluation, (last, now), False, "iterations used up")

    first = Solution(usual.start, evaluation, (200.0, costs[0]), False, "iterations used up")
    monkeypatch.setattr(refit_beginning, "_led", lambda *_: first)
    monkeypatch.setattr(refit_beginning, "minimise", further)
    found, said = begun(iterations=2)
    assert found is not None and len(seen) == 1 + asked and set(seen) == {1}
    made = len(costs) - len(left)
    assert found.history[-1] == costs[made - 1] and f"after {made} iterations" in said[0]


@pytest.mark.parametrize(("promised", "asked"), [(0.35, True), (0.25, False)])
def test_a_refit_goes_on_where_the_next_iteration_promises_much(
    promised: float, asked: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """promised: share of the cost, of which the last iteration had brought a twentieth."""
    _, before, usual, _ = scene()
    seen: list[int] = []

    def further(_problem: object, belief: Belief, *, iterations: int, **_: object) -> Solution:
        seen.append(iterations)
        return Solution(belief, before.evaluation, (95.0, 20.0), True, "converged")

    monkeypatch.setattr(refit_beginning, "promise", lambda *_: promised * 95.0)
    monkeypatch.setattr(refit_beginning, "minimise", further)
    last = Solution(usual.start, before.evaluation, (100.0, 95.0), False, "iterations used up")
    assert (refit_beginning._further(None, last, 1e-3) is not None) is asked
    assert seen == [1] * asked


def test_a_refit_whose_jacobian_cannot_be_computed_goes_no_further() -> None:
    _, before, usual, _ = scene()

    def unstable() -> np.ndarray:
        raise SimulationError("unstable")

    blind = replace(before.evaluation, slopes=unstable)
    last = Solution(usual.start, blind, (100.0, 95.0), False, "iterations used up")
    assert refit_beginning._further(None, last, 1e-3) is None


def test_no_jacobian_is_asked_what_noise_rules_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        refit_beginning, "promise", lambda _belief, evaluation: 0.0 * evaluation.jacobian[0, 0]
    )
    _, before, usual, _ = scene()
    asked: list[bool] = []

    def at(misfit: float) -> Solution:
        residual = np.full_like(before.evaluation.residual, misfit)
        slopes = before.evaluation.jacobian
        found = replace(before.evaluation, residual=residual, slopes=lambda: asked.append(True) or slopes)
        return Solution(usual.start, found, (1.05 * found.cost, found.cost), False, "iterations used up")

    # 0.7 of 1.1 squared is less than one.
    assert refit_beginning._further(None, at(1.1), 1e-3) is None and not asked
    assert refit_beginning._further(None, at(1.3), 1e-3) is None and asked


@pytest.mark.parametrize(
    # below from the start, on the way, and never
    "hopeless",
    [2e5, 6e4, 1.0],
)
def test_a_hopeless_refit_that_falls_has_as_many_iterations_as_another(
    hopeless: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, before, usual, _ = scene()

    def at(chi_square: float) -> Evaluation:
        residual = np.zeros_like(before.evaluation.residual)
        residual[0] = math.sqrt(chi_square)
        return replace(before.evaluation, residual=residual)

    left = [1e5 * 0.5**k for k in range(20)]

    def further(_problem: object, belief: Belief, *, iterations: int, **_: object) -> Solution:
        costs = [left.pop(0) for _ in range(iterations + 1)]
        left.insert(0, costs[-1])
        return Solution(belief, at(costs[-1]), tuple(costs), False, "iterations used up")

    first = Solution(usual.start, at(1e5), (2e5, 1e5), False, "iterations used up")
    monkeypatch.setattr(refit_beginning, "_led", lambda *_: first)
    monkeypatch.setattr(refit_beginning, "minimise", further)
    _, said = begun(iterations=2, hopeless=hopeless)
    assert f"after {2 + refit_beginning.MORE} iterations" in said[0]


def test_a_refit_finds_its_effect() -> None:
    _, before, entry, _ = scene()
    solution, said = begun()
    assert solution.evaluation.chi_square < 0.1 * before.evaluation.chi_square
    assert solution.belief["viscosity.eta"].value == pytest.approx(ETA, rel=0.1)
    assert "with viscosity" in said[0]
    # Strengths that cannot be negative are fitted in their logarithm.
    assert solution.belief["viscosity.eta"].log and not entry.start["viscosity.eta"].log


def test_derivatives_that_are_known_lead_a_refit_nearer_to_its_minimum() -> None:
    experiment, before, entry, _ = scene()
    problem = experiment.problem(SPACING)
    start = before.belief.with_effect("viscosity", {"eta": 0.5 * ETA})
    there = problem.evaluate(start, jacobian=False)
    evaluation = _evaluated(problem, before, start)
    assert evaluation.cost == pytest.approx(there.cost, rel=1e-4)
    exact = problem.evaluate(start).jacobian
    new = [k for k, p in enumerate(start.free) if p.key == "viscosity.eta"]
    old = [k for k in range(len(start.free)) if k not in new]
    assert np.abs(exact[:, new]).max() > 0.0
    scale = np.abs(exact[:, new]).max()
    np.testing.assert_allclose(evaluation.jacobian[:, new], exact[:, new], atol=1e-4 * scale)
    rows = evaluation.data_rows
    np.testing.assert_array_equal(evaluation.jacobian[:rows, old], before.evaluation.jacobian[:rows])
    after = problem.evaluate(approached_from(problem, before, start), jacobian=False)
    assert after.cost < 0.3 * there.cost


def test_derivatives_of_other_frames_do_not_lead() -> None:
    experiment, before, entry, _ = scene()
    start = before.belief.with_effect("viscosity", {"eta": 0.5 * ETA})
    assert approached_from(experiment.window(SPACING, 0.5), before, start) is start


@cache
def heavier_towards_the_tip() -> tuple[Experiment, Solution, RankedEffect]:
    """A bar whose density grows along it, the plain model fitted to it, and what the ranking says."""
    capture = bar_capture(frames=40, fps=100.0, fit=(0, 40))
    plain = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    along = {"part": "part0", "axis": [1.0, 0.0, 0.0]}
    capture = recorded(capture, plain.with_effect("density_gradient", {"slope": 15.0}, along))
    experiment = Experiment.of(capture, Settings(SPACING, workers=1))
    before = minimise(experiment.problem(SPACING), plain)
    ranking = rank(
        experiment, before.belief, before.evaluation, SPACING,
        generator=np.random.default_rng(0), names=("density_gradient",),
    )  # fmt: skip
    return experiment, before, ranking.entries[0]


def test_a_gradient_s_axis_is_sought_among_those_of_its_part() -> None:
    experiment, before, entry = heavier_towards_the_tip()
    assert len(entry.others) == 3
    axes = np.array([start.term("density_gradient").settings["axis"] for start in entry.others])
    np.testing.assert_allclose(np.abs(axes @ axes.T), np.eye(3), atol=1e-12)
    # The linear prediction goes across the bar: the data then decide.
    astray = np.array([0.05, 0.06, -1.0]) / np.linalg.norm([0.05, 0.06, -1.0])
    settings = {"part": "part0", "axis": astray.tolist()}
    wrong = before.belief.with_effect("density_gradient", {"slope": 100.0}, settings)
    entry = replace(entry, start=wrong)
    found = start_refit(experiment, before, entry, SPACING)
    axis = np.array(found.belief.term("density_gradient").settings["axis"])
    slope = found.belief["density_gradient.slope"].value * axis
    np.testing.assert_allclose(slope, [15.0, 0.0, 0.0], atol=1.0)
    alone = start_refit(experiment, before, replace(entry, others=()), SPACING)
    assert alone.evaluation.chi_square > 1.5 * found.evaluation.chi_square


def test_a_refit_that_is_begun_goes_on_to_the_accuracy_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, before, entry, _ = scene()
    asked: list[float] = []

    def counted(*given: object, relative_tolerance: float, **named: object) -> Solution:
        asked.append(relative_tolerance)
        return minimise(*given, relative_tolerance=relative_tolerance, **named)

    monkeypatch.setattr(refit_beginning, "minimise", counted)
    # The first iteration, those that bring much, the rest.
    monkeypatch.setattr(refit_beginning, "FALLING", 1.0)
    assert start_refit(experiment, before, entry, SPACING, iterations=2, hopeless=0.0, accuracy=1e-5)
    alone = len(asked)
    assert alone > 1 and set(asked) == {1e-5}
    assert start_refit(experiment, before, entry, SPACING, iterations=3, accuracy=1e-5)
    assert len(asked) > alone + 1 and set(asked) == {1e-5}


def test_a_hopeless_refit_ends_once_it_hardly_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levenberg_marquardt, "SECANTS", 0)  # with them the first iteration is the last
    with monkeypatch.context() as patch:
        patch.setattr(refit_beginning, "MORE", 0)
        once, _ = begun(iterations=1)
    first = once.evaluation.chi_square
    # The first iteration took more than three tenths of the cost: another one is made, and takes it below.
    fallen, said = begun(hopeless=0.9 * first)
    assert not said[0].endswith("after 1 iterations")
    assert fallen.evaluation.chi_square < 0.9 * first
    monkeypatch.setattr(refit_beginning, "FALLING", 1e-9)
    solution, said = begun(hopeless=0.9 * first)
    assert said[0].endswith("after 1 iterations")
    assert solution.evaluation.chi_square == pytest.approx(first)
    going_on, said = begun(hopeless=1.1 * first)
    assert not said[0].endswith("after 1 iterations")
    assert going_on.evaluation.chi_square < first


def test_a_refit_of_a_window_looks_at_its_frames_alone() -> None:
    solution, _ = begun(share=0.5, iterations=1)
    rows = solution.evaluation.data_rows
    assert rows == scene()[1].evaluation.data_rows // 2


def test_no_refit_where_the_model_cannot_be_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, before, _, _ = scene()
    problem = type(experiment.problem(SPACING))

    def unstable(*_: object, **__: object) -> None:
        raise SimulationError("unstable")

    monkeypatch.setattr(problem, "evaluate", unstable)
    assert begun() == (None, [])


def test_a_refit_is_finished_and_judged_on_unseen_frames() -> None:
    experiment, before, entry, _ = scene()
    solution, _ = begun(iterations=1)
    compared = experiment.compare(before.belief, SPACING)

    def finish(hopeless: float) -> refit.Refit | None:
        return finish_refit(
            experiment, before, compared, entry, solution, SPACING,
            generator=np.random.default_rng(0), hopeless=hopeless,
        )  # fmt: skip

    found = finish(math.inf)
    assert found.pays and found.gain.accepted and found.assessment.worst < 1.15
    assert found.belief["viscosity.eta"].value == pytest.approx(ETA, rel=0.05)
    after = found.solution.evaluation.chi_square
    assert found.actual_drop == pytest.approx(before.evaluation.chi_square - after)
    assert finish(0.9 * after) is None


# Far from the floor an iteration has to bring more.
@pytest.mark.parametrize(("far", "brings"), [(refit.FAR, refit.BRINGS), (0.5, refit.BRINGS_FAR)])
def test_a_refit_that_hardly_falls_is_not_brought_further(
    far: float, brings: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(refit, "FAR", far)
    experiment, before, entry, _ = scene()
    solution, _ = begun(iterations=1)
    compared = experiment.compare(before.belief, SPACING, jacobian=False)
    asked: list[tuple[int, float]] = []
    minimise = refit.minimise

    def counted(*args: object, iterations: int, least: float = 0.0, **options: object) -> Solution:
        asked.append((iterations, least))
        return replace(minimise(*args, iterations=1, least=least, **options), converged=False)

    monkeypatch.setattr(refit, "minimise", counted)
    finish_refit(
        experiment, before, compared, entry, solution, SPACING,
        generator=np.random.default_rng(0), accuracy=2e-3, iterations=8,
    )  # fmt: skip
    assert asked[:2] == [(3, 0.0), (5, pytest.approx(brings * 2e-3))]


@pytest.mark.parametrize("little", [True, False])
def test_what_sets_in_is_left_to_the_deciding_grid_sooner(
    little: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """little: whether the last of the first iterations brought too little for another one."""
    experiment, before, entry, _ = scene()
    compared = experiment.compare(before.belief, SPACING, jacobian=False)
    reason = levenberg_marquardt.TOO_LITTLE if little else "iterations used up"
    asked: list[float] = []

    def counted(*_: object, least: float = 0.0, **__: object) -> Solution:
        asked.append(least)
        return replace(before, converged=False, reason=reason)

    monkeypatch.setattr(refit, "minimise", counted)
    monkeypatch.setattr(refit, "relocated", lambda _p, found, **_: found)
    finish_refit(
        experiment, before, compared, replace(entry, kind="threshold"), before, SPACING,
        generator=np.random.default_rng(0), accuracy=2e-3,
    )  # fmt: skip
    assert asked[0] == pytest.approx(refit.BRINGS_SETTING_IN * 2e-3)
    assert refit.BRINGS_SETTING_IN > refit.BRINGS
    assert len(asked) == (1 if little else 2)


# ---- the gain on unseen frames ----------------------------------------------------------------
def offset(compared: dict[str, Compared], seen: float, unseen: float) -> dict[str, Compared]:
    """The comparison with predictions off by these [m] in fitted frames and in the others."""
    out = {}
    for name, item in compared.items():
        predicted = item.observation.position.copy()
        predicted[slice(*item.fit)] += seen
        predicted[slice(*item.predict)] += unseen
        out[name] = replace(item, predicted=predicted)
    return out


def truth_compared() -> tuple[dict[str, Compared], Belief]:
    experiment, before, _, _ = scene()
    return experiment.compare(before.belief, SPACING, jacobian=False), before.belief


def test_the_gain_counts_unseen_frames_alone() -> None:
    compared, _ = truth_compared()
    sigma = compared["a"].observation.sigma
    before, after = offset(compared, 0.0, 2.0 * sigma), offset(compared, 5.0 * sigma, sigma)
    gain = unseen_gain(before, after, np.random.default_rng(0))
    count = 16 * 4 * 3
    assert gain.gain == pytest.approx(0.5 * (4.0 - 1.0) * count, rel=1e-6)
    # The same gain in every frame: nothing for the bootstrap to vary, and blocks enough of two frames each.
    assert gain.block_count == 8 and gain.low == pytest.approx(gain.gain) and gain.accepted
    assert gain.plain == pytest.approx(3.0, rel=1e-6)
    assert unseen_gain(after, before, np.random.default_rng(0)).plain == pytest.approx(-3.0, rel=1e-6)


def test_a_likelihood_that_gains_while_the_motion_is_further_off_does_not_pay() -> None:
    compared, _ = truth_compared()
    item = compared["a"]
    noise = item.observation.noise
    lasting = replace(noise, correlated_share=np.array(1.0), correlation=Autoregression((0.9,)))
    item = replace(item, observation=replace(item.observation, noise=lasting))
    first, last = item.predict
    sigma = item.observation.sigma
    trembling, drifting = (item.observation.position.copy() for _ in range(2))
    trembling[first:last:2] += sigma
    drifting[first:last] += 1.2 * sigma
    before, after = ({"a": replace(item, predicted=p)} for p in (trembling, drifting))
    gain = unseen_gain(before, after, np.random.default_rng(0))
    # A tremble is nothing like such noise; a lasting error is, however far off.
    assert gain.low > 0.0
    assert gain.plain == pytest.approx(0.5 - 1.44) and not gain.accepted


def test_no_gain_where_too_few_frames_were_left_out() -> None:
    compared, _ = truth_compared()
    for predict in ((0, 0), (24, 30)):
        few = {name: replace(item, predict=predict) for name, item in compared.items()}
        assert unseen_gain(few, few, np.random.default_rng(0)) is None


def test_a_coarser_grid_leads_a_refit(monkeypatch: pytest.MonkeyPatch) -> None:
    experiment, before, entry, _ = scene()
    coarse = 1.4 * SPACING
    experiment.predictor("a", coarse)
    asked: list[float] = []
    predict = Predictor.predict

    def counted(self: Predictor, *given: object, **named: object) -> Prediction:
        if named.get("keys"):
            asked.append(self.settings.spacing)
        return predict(self, *given, **named)

    monkeypatch.setattr(Predictor, "predict", counted)
    alone = start_refit(experiment, before, entry, SPACING, iterations=4)
    count = len(asked)
    assert set(asked) == {SPACING}
    asked.clear()
    led = start_refit(
        experiment, before, entry, SPACING, iterations=4, jacobian_problem=experiment.problem(coarse)
    )
    assert asked[0] == coarse and asked.count(SPACING) < count
    assert led.evaluation.chi_square == pytest.approx(alone.evaluation.chi_square, rel=0.05)
    assert led.belief["viscosity.eta"].value == pytest.approx(ETA, rel=0.1)
