"""Where a wall stands is found from a bar that swings into it."""

from __future__ import annotations

import threading
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from bar_capture import DOWN, bar_belief, bar_capture
from mphygs.capture.format import Capture
from mphygs.compare.noise import Observation
from mphygs.diagnose import contact_search
from mphygs.diagnose.contact_search import proposals, search, search_softer, sphere, walls
from mphygs.diagnose.wall import Plane, hold_friction, release_friction
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Evaluation, Problem
from mphygs.fit.stiffness_scale import find_scale, with_materials_at_prior
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Predictor, Settings
from mphygs.simulate.prestress import RestShape
from variants_example import WALL_EFFECT, with_wall

SIGMA = 2e-4  # [m]
# The measured bar is made on another grid than the one that looks at it.
SPACING, OTHER = 0.01, 0.0085
FRAMES = 20
NORMAL = np.array([-0.1, 0.15, 1.0]) / np.linalg.norm([-0.1, 0.15, 1.0])
# Where the bar's tip strikes [m].
STRUCK = np.array([0.055, 0.01, -0.012])
WALL = Plane(NORMAL, float(NORMAL @ STRUCK))


def falling_bar(rest: str = "stress-free") -> tuple[Capture, Belief]:
    """A clamped bar released under its weight; where it rests in equilibrium already, its hold jerks."""
    jerk = None
    if rest == "equilibrium":
        jerk = -0.03 * np.sin(np.linspace(0.0, 3.0, FRAMES))[:, None] ** 2 * [0.0, 0.0, 1.0]
    capture = bar_capture(
        frames=FRAMES, fps=100.0, rest=rest, sigma=SIGMA, fit=(0, FRAMES), motion=jerk, gravity=DOWN
    )
    prestress = "equilibrium" if rest == "equilibrium" else "off"
    belief = bar_belief(capture, youngs_modulus=2e4, prestress=prestress, free=("part0.youngs_modulus",))
    return capture, belief


def seen(capture: Capture, truth: Belief, spacing: float = OTHER) -> Capture:
    """The capture with markers simulated at the truth, noise added."""
    recording = capture.sequence("a")
    position = Predictor(capture, recording, Settings(spacing, workers=1)).predict(truth).position
    position = position + SIGMA * np.random.default_rng(0).standard_normal(position.shape)
    markers = replace(recording.markers, position=position)
    return replace(capture, sequences=(replace(recording, markers=markers),))


Case = tuple[Problem, Observation, Belief, Evaluation]


def case_of(capture: Capture, belief: Belief) -> Case:
    experiment = Experiment.of(capture, Settings(SPACING, workers=1))
    problem = experiment.problem(SPACING)
    return problem, experiment.observations["a"], belief, problem.evaluate(belief, jacobian=False)


@cache
def walled(rest: str = "stress-free") -> Case:
    """The bar that strikes the wall, and the model that knows of none."""
    capture, belief = falling_bar(rest)
    return case_of(seen(capture, with_wall(belief, WALL)), belief)


# ---- proposals --------------------------------------------------------------------------------
def test_directions_are_unit_vectors_spread_evenly() -> None:
    n = sphere(400)
    np.testing.assert_allclose(np.linalg.norm(n, axis=1), 1.0)
    np.testing.assert_allclose(n.mean(0), 0.0, atol=5e-3)
    np.testing.assert_allclose(n.T @ n / len(n), np.eye(3) / 3.0, atol=5e-3)
    nearest = np.sort(n @ n.T, axis=1)[:, -2]
    # A cap of 1/400 of the sphere around each: none has a neighbour within half of that radius.
    assert np.degrees(np.arccos(nearest.max())) > 0.5 * np.degrees(np.arccos(1.0 - 2.0 / 400))


def stopped(depth: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
    """Predicted and measured (T, M, 3) of markers that fall by 1 along x and are stopped `depth` before."""
    at = np.array([[0.0, 0, 0], [0, 0.3, 0], [0, 0, 0.3], [0, 0.3, 0.3]])
    fall = np.linspace(0.0, 1.0, 21)[:, None, None] * [1.0, 0.0, 0.0]
    predicted = at + fall
    measured = predicted.copy()
    measured[..., 0] = np.minimum(measured[..., 0], 1.0 - depth)
    return predicted, measured


def test_the_plane_that_stops_what_falls_is_proposed_first() -> None:
    predicted, measured = stopped()
    sigma = 1e-3
    first = proposals(predicted, measured, sigma)[0]
    assert first.plane.normal[0] < -np.cos(0.1)
    n = first.plane.normal
    limit = (measured.reshape(-1, 3) @ n).min()
    assert first.plane.offset == pytest.approx(limit - 2.0 * sigma)
    assert first.depth == pytest.approx(limit - 3.0 * sigma - (predicted.reshape(-1, 3) @ n).min())
    # It is passed by all markers alike, where they were stopped.
    np.testing.assert_allclose(first.pivot, [0.4, 0.15, 0.15], atol=0.05)


def test_proposals_are_free_of_measured_points_and_apart() -> None:
    predicted, measured = stopped()
    rng = np.random.default_rng(2)
    measured = measured + 1e-3 * rng.standard_normal(measured.shape)
    measured[5, 1] = np.nan
    found = proposals(predicted, measured, 1e-3, count=6)
    assert 1 < len(found) <= 6
    points = measured[np.isfinite(measured).all(-1)]
    for k, one in enumerate(found):
        assert (points @ one.plane.normal > one.plane.offset).all()
        assert one.depth > 0 and (predicted.reshape(-1, 3) @ one.plane.normal < one.plane.offset).any()
        for other in found[:k]:
            assert one.plane.normal @ other.plane.normal < contact_search.APART


def test_no_plane_where_the_prediction_stays_among_what_was_measured() -> None:
    predicted, measured = stopped()
    assert proposals(measured, predicted, 1e-3) == []
    assert proposals(measured + 1e-3, measured, 1e-3) == []
    assert proposals(predicted, np.full_like(measured, np.nan) + 0.0, 1e-3) == []


# ---- moves ------------------------------------------------------------------------------------
def test_a_proposal_moves_by_tilt_about_its_pivot_and_by_depth() -> None:
    proposal = contact_search._Proposal(WALL, STRUCK + 0.002 * NORMAL, 0.01)
    same = contact_search._moved(proposal, np.zeros(3))
    np.testing.assert_allclose([*same.normal, same.offset], [*NORMAL, WALL.offset])
    tilts = []
    for at in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-0.6, 0.8, 0.0)):
        plane = contact_search._moved(proposal, np.array(at))
        assert np.linalg.norm(plane.normal) == pytest.approx(1.0)
        assert np.arccos(plane.normal @ NORMAL) == pytest.approx(np.arctan(contact_search.TILT))
        # The pivot stands as far in front of the plane as before.
        assert plane.normal @ proposal.pivot - plane.offset == pytest.approx(0.002)
        tilts.append(plane.normal - (plane.normal @ NORMAL) * NORMAL)
    assert tilts[0] @ tilts[1] == pytest.approx(0.0, abs=1e-12)
    pushed = contact_search._moved(proposal, np.array([0.3, -0.2, 0.5]))
    tilted = contact_search._moved(proposal, np.array([0.3, -0.2, 0.0]))
    np.testing.assert_allclose(pushed.normal, tilted.normal)
    assert pushed.offset - tilted.offset == pytest.approx(0.5 * contact_search.DEPTH * proposal.depth)


def test_a_wall_in_a_belief_is_free_to_move() -> None:
    _, belief = falling_bar()
    extended = with_wall(belief, WALL)
    free = {p.key for p in extended.free} - {p.key for p in belief.free}
    assert free == {"contact.d", "contact.n_x", "contact.n_y", "contact.n_z", "contact.mu"}
    np.testing.assert_allclose([extended[f"contact.n_{a}"].value for a in "xyz"], NORMAL)
    assert extended["contact.d"].value == WALL.offset
    assert all(extended[f"contact.n_{a}"].prior_std == 0.5 for a in "xyz")


# ---- runs -------------------------------------------------------------------------------------
@pytest.mark.parametrize("rest", ["stress-free", "equilibrium"])
def test_runs_from_shortly_before_the_misfit_are_those_from_the_start(rest: str) -> None:
    problem, observation, belief, evaluation = walled(rest)
    runs = contact_search._Runs(problem, observation, belief, evaluation, WALL_EFFECT)
    assert runs.start is not None and 2 <= runs.start.frame <= 6
    assert runs.chi_square(None) == pytest.approx(evaluation.chi_square)
    # A wall that nothing reaches changes nothing, but for shorter substeps.
    far = runs.chi_square(Plane(NORMAL, -1.0))
    assert far == pytest.approx(evaluation.chi_square, rel=5e-3)
    whole = problem.evaluate(with_wall(belief, WALL), jacobian=False).chi_square
    assert whole < 0.1 * evaluation.chi_square
    assert runs.chi_square(WALL) == pytest.approx(whole, rel=0.2)


def test_runs_begin_at_rest_where_the_state_is_more_than_place_and_velocity() -> None:
    problem, observation, belief, evaluation = walled()
    relaxing = belief.with_effect("relaxation", {"ratio": 0.0, "tau": 0.1})
    assert contact_search._Runs(problem, observation, relaxing, evaluation, WALL_EFFECT).start is None


def test_a_frame_that_shows_no_marker_is_no_misfit() -> None:
    problem, observation, belief, evaluation = walled()
    position = observation.position.copy()
    position[1] = np.nan
    blank = Observation(position, observation.noise, observation.weight)
    begun = contact_search._Runs(problem, observation, belief, evaluation, WALL_EFFECT).start
    assert contact_search._Runs(problem, blank, belief, evaluation, WALL_EFFECT).start.frame == begun.frame
    assert search(problem, blank, belief, evaluation, WALL_EFFECT)


# ---- search -----------------------------------------------------------------------------------
def test_the_wall_that_a_bar_swings_into_is_found() -> None:
    problem, observation, belief, evaluation = walled()
    said: list[str] = []
    planes = search(problem, observation, belief, evaluation, WALL_EFFECT, report=said.append)
    assert 1 <= len(planes) <= contact_search.MOVED and len(said) == 1 + len(planes)
    best = planes[0]
    assert best.chi_square == min(p.chi_square for p in planes) < 0.01 * evaluation.chi_square
    assert np.degrees(np.arccos(best.normal @ NORMAL)) < 10.0
    # As far from the point that strikes as the grids tell apart.
    assert abs(best.normal @ STRUCK - best.offset) < 0.15 * SPACING
    again = problem.evaluate(with_wall(belief, best), jacobian=False).chi_square
    assert best.chi_square == pytest.approx(again, rel=0.3)


@pytest.mark.parametrize("rest", ["stress-free", "equilibrium"])
def test_the_search_is_the_same_with_two_workers(rest: str) -> None:
    problem, observation, belief, evaluation = walled(rest)
    found = []
    for workers in (1, 2):
        # Neither finds the rest shape solved for already.
        problem.predictors["a"].transfer.forget()
        planes = search(problem, observation, belief, evaluation, WALL_EFFECT, workers=workers)
        found.append([[*p.normal, p.offset, p.chi_square] for p in planes])
    assert found[0] and found[0] == found[1]


def test_walls_ask_for_no_other_rest_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, observation, belief, evaluation = walled("equilibrium")
    # Runs from rest on need no state, which would have been solved for by itself.
    monkeypatch.setattr(contact_search._Runs, "_start", lambda *_: None)
    problem.predictors["a"].transfer.forget()
    solved, newton = [], RestShape._newton

    def counted(self: RestShape, *arguments: object) -> dict:
        solved.append(threading.current_thread())
        return newton(self, *arguments)

    monkeypatch.setattr(RestShape, "_newton", counted)
    assert search(problem, observation, belief, evaluation, WALL_EFFECT, workers=2)
    assert solved == [threading.main_thread()]


def test_no_wall_for_a_prediction_that_passes_no_free_plane() -> None:
    problem, observation, belief, evaluation = walled()
    # Always half way between two places where the same marker was measured.
    between = 0.5 * (observation.position[:1] + observation.position)
    inside = replace(evaluation, positions={"a": between})
    assert np.sqrt(np.mean((between - observation.position) ** 2)) > 10.0 * SIGMA
    assert search(problem, observation, belief, inside, WALL_EFFECT) == []


def test_a_model_with_a_wall_gets_no_other() -> None:
    problem, observation, belief, evaluation = walled()
    assert search(problem, observation, with_wall(belief, WALL), evaluation, WALL_EFFECT) == []
    assert search_softer(problem, observation, with_wall(belief, WALL), evaluation, WALL_EFFECT) == []


def test_walls_that_do_not_help_are_not_moved(monkeypatch: pytest.MonkeyPatch) -> None:
    capture, belief = falling_bar()
    # The measured bar is stiffer: it stays behind the prediction, and no wall explains how.
    stiff = belief.with_parameter("part0.youngs_modulus", value=2.1e4)
    problem, observation, belief, evaluation = case_of(seen(capture, stiff, SPACING), belief)
    monkeypatch.setattr(contact_search, "minimize", lambda *_a, **_k: pytest.fail("a plane was moved"))
    planes = search(problem, observation, belief, evaluation, WALL_EFFECT)
    assert len(planes) == 1
    assert planes[0].chi_square > contact_search.HELPS * evaluation.chi_square


@cache
def held_up(rest: str = "stress-free") -> Case:
    """The bar that meets a wall soon, and the model that was fitted too stiff to reach it."""
    capture, belief = falling_bar(rest)
    near = Plane(WALL.normal, WALL.offset + 0.004)
    recorded = seen(capture, with_wall(belief, near))
    stiff = belief.with_parameter("part0.youngs_modulus", value=1.5e5)
    return case_of(recorded, stiff)


@pytest.mark.parametrize("rest", ["stress-free", "equilibrium"])
def test_a_softer_object_meets_the_wall_that_the_fitted_one_is_too_stiff_to_reach(rest: str) -> None:
    problem, observation, belief, evaluation = held_up(rest)
    softly = problem.narrowed(0.6)
    evaluation = softly.evaluate(belief, jacobian=False)
    assert evaluation.misfit > contact_search.OFF
    said: list[str] = []
    found = search_softer(softly, observation, belief, evaluation, WALL_EFFECT, report=said.append)
    assert 1 <= len(found) <= contact_search.MOVED and len(said) == 1
    soft, plane = found[0]
    best = find_scale(softly, with_materials_at_prior(belief))["part0.youngs_modulus"].value
    shares = soft["part0.youngs_modulus"].value / best
    assert min(abs(shares - share) for share in contact_search.SOFTER) < 1e-9
    assert plane.chi_square < contact_search.HELPS * evaluation.chi_square
    walled = softly.evaluate(with_wall(soft, plane), jacobian=False)
    assert walled.chi_square == pytest.approx(plane.chi_square, rel=0.3)
    # The same whoever runs them.
    again = search_softer(softly, observation, belief, evaluation, WALL_EFFECT, workers=2)
    assert [(*p.normal, p.offset) for _, p in again] == [(*p.normal, p.offset) for _, p in found]


@pytest.mark.parametrize(
    ("share", "sigma", "left", "known", "asked"),
    [
        (0.25, 1.3, None, (), True),
        (0.4, 1.3, None, (), False),  # right on its first frames
        (0.25, 1.2, None, (), False),  # and here everywhere
        (0.25, 1.3, None, ("viscosity",), False),  # no first model
        (0.25, 1.3, 0.9, (), True),  # a plane that hardly helps
        (0.25, 1.3, 0.7, (), False),
    ],
)
def test_softer_objects_are_asked_for_where_the_first_model_is_off_early_and_no_wall_helps(
    share: float,
    sigma: float,
    left: float | None,
    known: tuple[str, ...],
    asked: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem, observation, belief, evaluation = walled()
    for name in known:
        belief = belief.with_effect(name)
    evaluation = replace(evaluation, residual=evaluation.residual * sigma / evaluation.misfit)
    plane = replace(WALL, chi_square=(left or 0.0) * evaluation.chi_square)
    soft, better = object(), replace(WALL, offset=0.0)
    monkeypatch.setattr(contact_search, "search", lambda *_a, **_k: [] if left is None else [plane])
    for found in ([(soft, better)], []):
        monkeypatch.setattr(contact_search, "search_softer", lambda *_a, f=found, **_k: f)
        usual = [] if left is None else [(belief, plane)]
        expected = found if asked and found else usual
        assert walls(problem, observation, belief, evaluation, WALL_EFFECT, share=share) == expected


def test_softer_parts_are_no_wall_where_the_model_is_right(monkeypatch: pytest.MonkeyPatch) -> None:
    capture, belief = falling_bar()
    problem, observation, belief, evaluation = case_of(seen(capture, belief, SPACING), belief)
    assert search_softer(problem, observation, belief, evaluation, WALL_EFFECT) == []

    # Nor where no softer object can be simulated.
    def fails(*_: object, **__: object) -> None:
        raise SimulationError("unstable")

    monkeypatch.setattr(contact_search, "find_scale", fails)
    assert search_softer(problem, observation, belief, evaluation, WALL_EFFECT) == []


def test_friction_is_held_until_the_wall_stands() -> None:
    capture = bar_capture()
    belief = bar_belief(capture, free=())
    assert hold_friction(belief) is belief and release_friction(belief) is belief
    walled = with_wall(belief, Plane(np.array([0.0, 0.0, 1.0]), -0.01))
    walled = walled.with_parameter("contact.mu", value=0.0)
    held = hold_friction(walled)
    assert [p.key for p in held.free] == ["contact.d", "contact.n_x", "contact.n_y", "contact.n_z"]
    (usual,) = (p.scale for p in WALL_EFFECT.of_role("strength"))
    assert held["contact.mu"].value == usual
    freed = release_friction(held)
    assert "contact.mu" in [p.key for p in freed.free] and freed["contact.mu"].value == usual
