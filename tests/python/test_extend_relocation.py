"""Other places that an effect may sit at, where its own is stuck."""

from __future__ import annotations

import numpy as np
import pytest

from mphygs.extend import relocation
from mphygs.extend.relocation import APART, other_places, places_around, relocated_anywhere
from mphygs.fit.levenberg_marquardt import Solution, minimise
from mphygs.fit.place_fit import moved, place_of
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError
from test_fit_place_fit import MASS_AT, SPACING, scene

FAR_END = np.array([0.055, 0.003, 0.003])


def stuck(place: np.ndarray = FAR_END) -> tuple[Problem, Solution, Belief]:
    """A fit with a mass at a place that is not its own, and the truth."""
    experiment, truth = scene(frames=12)
    problem = experiment.problem(SPACING)
    return problem, minimise(problem, moved(truth, "attached_mass", place), iterations=6), truth


def test_places_around_are_in_the_material_and_apart() -> None:
    problem, solution, _ = stuck()
    vertices = np.concatenate([part.vertices for part in problem.capture.parts])
    places = places_around(problem, place_of(solution.belief, "attached_mass"))
    assert len(places) > 4
    assert np.all(places > vertices.min(0) - 1e-9) and np.all(places < vertices.max(0) + 1e-9)
    both = np.vstack([places, FAR_END])
    between = np.linalg.norm(both[:, None] - both[None], axis=-1) + np.eye(len(both))
    assert between.min() > APART * SPACING


def test_the_most_promising_of_other_places_comes_first() -> None:
    """Even where the mass was fitted away at the wrong place."""
    problem, solution, _ = stuck()
    assert solution.belief["attached_mass.m"].value == 0.0
    assert solution.evaluation.misfit > 2.0
    near = MASS_AT + [0.001, 0.0, 0.0]
    places = [np.array([0.01, 0.01, 0.01]), np.array([0.03, 0.003, 0.003]), near]
    found = other_places(problem, solution, "attached_mass", places)
    assert len(found) == relocation.KEPT
    assert np.array_equal(place_of(found[0], "attached_mass"), near)
    assert all(belief["attached_mass.m"].value > 0.0 for belief in found)


def test_a_place_that_cannot_be_simulated_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, solution, _ = stuck()
    whole = Problem.evaluate

    def evaluate(self: Problem, belief: Belief, **options: object) -> object:
        if place_of(belief, "attached_mass")[0] < 0.02:
            raise SimulationError("unstable")
        return whole(self, belief, **options)

    monkeypatch.setattr(Problem, "evaluate", evaluate)
    found = other_places(problem, solution, "attached_mass", [np.array([0.01, 0.01, 0.01]), MASS_AT])
    assert [tuple(place_of(belief, "attached_mass")) for belief in found] == [tuple(MASS_AT)]


def test_a_place_that_steps_do_not_lead_to_is_found_from_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, solution, _ = stuck()
    # Steps by the derivative that get nowhere from where it is.
    monkeypatch.setattr(relocation, "relocated", lambda _problem, start, **_: start)
    end = relocated_anywhere(problem, solution, relative_tolerance=1e-4)
    assert end.evaluation.misfit < 1.1 < solution.evaluation.misfit
    assert np.linalg.norm(place_of(end.belief, "attached_mass") - MASS_AT) < 2e-3


def test_what_is_at_noise_is_looked_for_nowhere_else(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, solution, _ = stuck(MASS_AT)
    assert solution.evaluation.misfit < relocation.AT_NOISE
    monkeypatch.setattr(relocation, "other_places", lambda *_: pytest.fail("other places were asked for"))
    monkeypatch.setattr(relocation, "relocated", lambda _problem, start, **_: start)
    assert relocated_anywhere(problem, solution) is solution
