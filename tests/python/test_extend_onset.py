"""Fits of what sets in at some moment."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SIGMA, recorded
from mphygs.diagnose.wall import Plane, hold_friction
from mphygs.extend import onset_fit
from mphygs.extend.onset_fit import fit_onset_then_all, only_onset_free, with_onset_fitted
from mphygs.fit.experiment import Experiment
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Settings
from variants_example import with_wall

SPACING = 0.01
FREE = ("part0.youngs_modulus",)
YOUNG = 2e4
NORMAL = np.array([-0.1, 0.15, 1.0]) / np.linalg.norm([-0.1, 0.15, 1.0])
STRUCK = np.array([0.055, 0.01, -0.012])


@cache
def struck() -> tuple[Problem, Belief]:
    """A bar that meets a floor, and its model with the floor elsewhere and tilted, friction held."""
    capture = bar_capture(frames=16, fps=100.0, sigma=SIGMA, fit=(0, 16))
    belief = bar_belief(capture, youngs_modulus=YOUNG, free=FREE)
    truth = hold_friction(with_wall(belief, Plane(NORMAL, float(NORMAL @ STRUCK))))
    problem = Experiment.of(recorded(capture, truth), Settings(SPACING, workers=1)).problem(SPACING)
    off = np.array([0.05, 0.1, 1.0]) / np.linalg.norm([0.05, 0.1, 1.0])
    return problem, hold_friction(with_wall(belief, Plane(off, float(off @ STRUCK) - 0.001)))


def plane_of(belief: Belief) -> tuple[np.ndarray, float]:
    n = np.array([belief[f"contact.n_{a}"].value for a in "xyz"])
    return n / np.linalg.norm(n), belief["contact.d"].value


def test_only_what_sets_in_is_free_alone() -> None:
    _, belief = struck()
    held = only_onset_free(belief)
    assert {p.key for p in held.free} == {"contact.d", "contact.n_x", "contact.n_y", "contact.n_z"}
    assert {p.key for p in belief.free} == {p.key for p in held.free} | set(FREE)
    assert not only_onset_free(belief.without_effect("contact")).free


def test_a_wall_is_put_in_its_place_with_the_materials_held() -> None:
    problem, belief = struck()
    before = problem.evaluate(belief, jacobian=False).misfit
    found = with_onset_fitted(problem, belief)
    assert [p.free for p in found.parameters] == [p.free for p in belief.parameters]
    assert found[FREE[0]].value == YOUNG
    normal, offset = plane_of(found)
    assert np.degrees(np.arccos(min(normal @ NORMAL, 1.0))) < 2.0
    assert offset == pytest.approx(NORMAL @ STRUCK, abs=2e-4)
    assert problem.evaluate(found, jacobian=False).misfit < 1.1 < 3.0 < before
    # Where nothing sets in there is nothing to place.
    plain = belief.without_effect("contact")
    assert with_onset_fitted(problem, plain) is plain


def test_all_is_fitted_after_that(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, belief = struck()
    off = belief.with_parameter(FREE[0], value=1.05 * YOUNG)
    calls: list[tuple[tuple[str, ...], int]] = []
    minimise = onset_fit.minimise

    def counted(problem: Problem, belief: Belief, *, iterations: int, **options: object) -> object:
        calls.append((tuple(p.key for p in belief.free), iterations))
        return minimise(problem, belief, iterations=iterations, **options)

    monkeypatch.setattr(onset_fit, "minimise", counted)
    solution = fit_onset_then_all(problem, off, iterations=5)
    assert [(len(keys), count) for keys, count in calls] == [(4, onset_fit.ALONE), (5, 5)]
    assert solution.belief[FREE[0]].value == pytest.approx(YOUNG, rel=0.02)
    assert solution.evaluation.misfit < 1.1


def test_what_is_hopeless_after_one_iteration_is_left_there() -> None:
    problem, belief = struck()
    off = belief.with_parameter(FREE[0], value=1.05 * YOUNG)
    within = fit_onset_then_all(problem, off, hopeless=1e9)
    assert within.evaluation.misfit < 1.1
    beyond = fit_onset_then_all(problem, off, hopeless=1e-9)
    assert len(beyond.history) <= 2 and beyond.evaluation.chi_square >= within.evaluation.chi_square
