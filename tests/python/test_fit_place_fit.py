"""Where an effect at a place sits, fitted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import recorded
from mphygs.extend.step_uncertainty import uncertainty
from mphygs.extend.steps import step_at, step_document
from mphygs.fit import place_fit, place_uncertainty
from mphygs.fit.determined import information_of
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import Solution, covariance, minimise
from mphygs.fit.place_fit import movable, moved, place_columns, place_of, relocated
from mphygs.fit.place_uncertainty import located, places_document, with_place_uncertainty
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Settings

SPACING = 0.005
KEYS = ("part0.youngs_modulus",)
MASS_AT, MIDDLE_OF_CELL = np.array([0.042, 0.013, 0.014]), np.array([0.0425, 0.0125, 0.0125])


def with_mass(belief: Belief, place: np.ndarray, mass: float = 8e-3) -> Belief:
    return belief.with_effect("attached_mass", {"m": mass}, {"place": np.asarray(place).tolist()})


def with_tether(belief: Belief, place: np.ndarray) -> Belief:
    values = {"k": 5.0, "anchor_x": 0.05, "anchor_y": 0.04, "anchor_z": 0.03}
    return belief.with_effect("tether", values, {"place": np.asarray(place).tolist()})


def scene(add: object = with_mass, frames: int = 16) -> tuple[Experiment, Belief]:
    capture = bar_capture(frames=frames, fps=60.0, fit=(0, frames))
    truth = add(bar_belief(capture, youngs_modulus=4e4, free=KEYS), MASS_AT)
    return Experiment.of(recorded(capture, truth, SPACING), Settings(SPACING, workers=1)), truth


@pytest.mark.parametrize("add", [with_mass, with_tether])
def test_the_derivative_by_a_place_is_that_of_small_moves(add: object) -> None:
    """From side to side of a cell and in its middle: much the same, but for what the grid has of its own."""
    experiment, truth = scene(add, frames=8)
    problem = experiment.problem(SPACING)
    truth = moved(truth, truth.effects[0], MIDDLE_OF_CELL)
    found = place_columns(problem, truth, truth.effects[0])
    assert found.columns.shape[1] == 3 and not found.room.any()
    for column, move in zip(found.columns.T, found.moves, strict=True):
        ahead, back = (
            problem.evaluate(
                moved(truth, truth.effects[0], MIDDLE_OF_CELL + share * move), jacobian=False
            ).residual
            for share in (0.05, -0.05)
        )
        small = (ahead - back) / 0.1
        assert np.linalg.norm(column) > 1.0
        assert column @ small > 0.9 * np.linalg.norm(column) * np.linalg.norm(small)
        assert np.linalg.norm(column) == pytest.approx(np.linalg.norm(small), rel=0.25)
    assert not found.columns[problem.evaluate(truth).data_rows :].any()


@pytest.mark.parametrize("add", [with_mass, with_tether])
def test_a_place_is_found_from_two_cells_off(add: object) -> None:
    experiment, truth = scene(add)
    name = truth.effects[0]
    problem = experiment.problem(SPACING)
    start = minimise(problem, moved(truth, name, MASS_AT + [-0.01, -0.002, -0.002]), iterations=6)
    assert start.evaluation.misfit > 2.0
    said: list[str] = []
    end = relocated(problem, start, relative_tolerance=1e-4, report=said.append)
    assert end.evaluation.misfit < 1.1
    assert np.linalg.norm(place_of(end.belief, name) - MASS_AT) < 2e-3
    assert any(line.startswith(f"{name} moved to (") for line in said)
    # At its minimum it stays where it is.
    assert relocated(problem, end, relative_tolerance=1e-4).belief is end.belief


def test_a_valley_is_followed_as_far_as_the_cost_falls(monkeypatch: pytest.MonkeyPatch) -> None:
    """A valley along x whose floor is lowest 12 mm on: from a move of 1 mm and a step of 0.01 of the modulus'
    logarithm, 2, 4 and 8 mm more are tried in turn, each from where the move ended."""
    experiment, truth = scene(frames=8)
    problem, name = experiment.problem(SPACING), "attached_mass"
    here, lowest = np.array([0.02, 0.0125, 0.0125]), 0.032
    asked: list[float] = []

    def evaluate(belief: Belief, **_: object) -> object:
        asked.append(float(place_of(belief, name)[0]))
        return replace(known, residual=np.full(4, 1.0 + abs(asked[-1] - lowest)))

    known = problem.evaluate(truth)
    before = moved(truth, name, here - [0.001, 0.0, 0.0])
    reached = moved(truth.at(truth.coordinates + 0.01), name, here)
    monkeypatch.setattr(problem, "evaluate", evaluate)
    start = replace(known, residual=np.full(4, 1.0 + lowest - here[0]))
    end = place_fit._further(problem, before, Solution(reached, start, (), True, ""), name)
    assert asked == pytest.approx([0.021, 0.022, 0.024, 0.028, 0.036])
    assert place_of(end, name) == pytest.approx([0.028, 0.0125, 0.0125])
    assert end.coordinates - reached.coordinates == pytest.approx(0.08)
    # Where it falls no further, the place stays.
    low = Solution(reached, replace(known, residual=np.full(4, 0.1)), (), True, "")
    assert place_fit._further(problem, before, low, name) is None


def test_steps_of_a_place_are_held_by_logarithms_alone() -> None:
    """A far anchor goes along with a place by many of its scale; a modulus may not."""
    _, truth = scene(with_tether, frames=8)
    log = np.array([p.log for p in truth.free])
    assert log.any() and not log.all()
    assert place_fit._largest(truth, np.where(log, 0.2, 50.0)) == pytest.approx(0.2)
    assert place_fit._largest(truth, np.where(log, -3.0, 0.0)) == pytest.approx(3.0)


@pytest.mark.parametrize("better", [True, False])
def test_the_middle_of_the_material_around_is_tried_as_well(
    better: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiment, truth = scene(frames=8)
    problem = experiment.problem(SPACING)
    corner = np.array([0.06, 0.02, 0.02])
    start = moved(truth, "attached_mass", corner)
    solution = Solution(start, problem.evaluate(start), (), True, "kept")
    walked: list[np.ndarray] = []

    def stay(_problem: object, found: Solution, name: str, *_: object) -> Solution:
        walked.append(place_of(found.belief, name))
        size = 0.5 if (len(walked) == 2) is better else 2.0
        return replace(found, evaluation=replace(found.evaluation, residual=np.full(4, size)))

    monkeypatch.setattr(place_fit, "walked", stay)
    end = relocated(problem, solution)
    first, second = walked
    assert np.array_equal(first, corner)
    # The middle of an eighth of a ball of three cells, along each axis: 3/8 of its radius.
    assert corner - second == pytest.approx(np.full(3, 0.375 * 3.0 * SPACING), rel=0.25)
    assert np.array_equal(place_of(end.belief, "attached_mass"), second if better else first)


def test_the_weight_of_a_known_load_stays_where_it_pulls() -> None:
    _, truth = scene()
    settings = {"place": MASS_AT.tolist(), "sequences": ["a"], "weight": False, "at_rest": False}
    hung = truth.without_effect("attached_mass").with_effect("attached_mass", {"m": 0.1}, settings)
    assert movable(truth) == ("attached_mass",) and movable(hung) == ()


def test_a_thin_object_leaves_no_room_across() -> None:
    capture = bar_capture(depth=0.001, frames=4, fit=(0, 4))
    belief = with_mass(bar_belief(capture, free=KEYS), [0.04, 0.01, 0.0005])
    experiment = Experiment.of(capture, Settings(SPACING, workers=1))
    found = place_columns(experiment.problem(SPACING), belief, "attached_mass")
    assert found.moves.shape == (2, 3) and not found.moves[:, 2].any()
    assert found.room == pytest.approx([0.0, 0.0, 0.001])


def test_uncertainty_is_that_of_a_fit_of_places_and_all_else() -> None:
    """The Schur complement against the inverse of the whole."""
    experiment, truth = scene()
    problem = experiment.problem(SPACING)
    evaluation = problem.evaluate(truth)
    found = place_columns(problem, truth, "attached_mass")
    rows = np.hstack([evaluation.jacobian, found.columns])
    prior = np.r_[np.zeros(len(truth.free)), found.prior**-2.0]
    whole = np.linalg.inv(rows.T @ rows + np.diag(prior))
    p = len(truth.free)
    alone = covariance(evaluation)
    information = information_of(evaluation, p)
    change = np.random.default_rng(0).normal(size=evaluation.data_rows)
    known = with_place_uncertainty(problem, truth, evaluation, alone, information, change)
    spread, less = known.covariance, known.information
    np.testing.assert_allclose(spread, whole[:p, :p], rtol=1e-6)
    by_grid = whole @ rows[: evaluation.data_rows].T @ change
    np.testing.assert_allclose(known.shift, by_grid[:p], rtol=1e-6)
    variance = np.diag(found.moves.T @ whole[p:, p:] @ found.moves)
    of_place = np.sqrt(variance + (by_grid[p:] @ found.moves) ** 2)
    np.testing.assert_allclose(known.std["attached_mass"], of_place, rtol=1e-6)
    unknown = with_place_uncertainty(problem, truth, evaluation, alone, information)
    np.testing.assert_allclose(unknown.std["attached_mass"], np.sqrt(variance), rtol=1e-6)
    assert unknown.shift is None
    # Not knowing the place costs something; nothing that has no place does.
    assert np.all(np.diag(spread) > np.diag(alone)) and less[0, 0] < information[0, 0]
    bare = truth.without_effect("attached_mass")
    bare_evaluation = problem.evaluate(bare)
    same = with_place_uncertainty(problem, bare, bare_evaluation, alone[:1, :1], information[:1, :1])
    assert np.array_equal(same.covariance, alone[:1, :1]) and same.std == {}


def test_a_step_tells_where_its_effect_sits() -> None:
    experiment, truth = scene()
    step = replace(step_at(experiment, truth, SPACING), added=("attached_mass",))
    told = step_document(step, experiment, ())["parameters"]
    stds = uncertainty(step, experiment).places["attached_mass"]
    for axis, value, std in zip("xyz", MASS_AT, stds, strict=True):
        entry = told[f"attached_mass.place_{axis}"]
        assert entry == {"value": value, "std": pytest.approx(std), "unit": "m", "determined": True}
        assert 0.0 < std < 0.01
    # A place that was given, not found, has no uncertainty to tell.
    assert places_document(truth) == {}
    parts = experiment.capture.parts  # 6.6 cm long
    unsure = located(truth, {"attached_mass": np.array([0.016, 0.017, 0.001])}, parts)
    known = places_document(unsure)
    assert [known[f"attached_mass.place_{axis}"]["determined"] for axis in "xyz"] == [True, False, True]
    assert known["attached_mass.place_y"]["note"] == "anywhere on the object"
    # Elsewhere it is not known any more.
    assert places_document(moved(unsure, "attached_mass", MASS_AT)) == {}


def test_a_place_beside_which_nothing_can_be_simulated_counts_as_known(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    experiment, truth = scene(frames=8)
    problem = experiment.problem(SPACING)
    evaluation = problem.evaluate(truth)

    def unstable(*_: object, **__: object) -> None:
        raise SimulationError("unstable")

    monkeypatch.setattr(place_uncertainty, "place_columns", unstable)
    alone, information = covariance(evaluation), information_of(evaluation, len(truth.free))
    same = with_place_uncertainty(problem, truth, evaluation, alone, information)
    assert np.array_equal(same.covariance, alone) and same.std == {}
