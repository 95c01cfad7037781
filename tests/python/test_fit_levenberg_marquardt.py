"""The optimiser on functions of which everything is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from extend_example import plain_belief
from mphygs.fit import borrowed_jacobians, damped_step, levenberg_marquardt
from mphygs.fit.borrowed_jacobians import approached
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.fit.problem import Evaluation
from mphygs.model.belief import Belief
from mphygs.simulate.errors import SimulationError

TRUTH = np.log([6e4, 1.1e3])
START = np.log([9e4, 0.9e3])
TIME = np.linspace(0.0, 1.0, 60)
SIGMA = 0.01


def swing(x: np.ndarray) -> np.ndarray:
    """A decaying swing whose frequency goes with sqrt(E / rho) and whose size with 1 / rho."""
    frequency = np.exp(0.5 * (x[0] - x[1]))
    return 1e3 * np.exp(-x[1]) * np.exp(-TIME) * np.sin(frequency * TIME)


def slope(f: Callable[[np.ndarray], np.ndarray], x: np.ndarray) -> np.ndarray:
    steps = 1e-6 * np.eye(len(x))
    return np.stack([(f(x + s) - f(x - s)) / 2e-6 for s in steps], axis=1)


class Toy:
    """What minimise asks of a problem; jacobians, forwards: calls so far."""

    def __init__(self, limit: float = np.inf) -> None:
        self.jacobians = self.forwards = 0
        self.limit = limit

    def stable_substep(self, _belief: Belief) -> float:
        return 1.0

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
        x = belief.coordinates
        if x[0] > self.limit:
            raise SimulationError("unstable")
        self.jacobians += jacobian
        self.forwards += not jacobian
        residual = (swing(TRUTH) - swing(x)) / SIGMA
        j = -slope(swing, x) / SIGMA if jacobian else lambda: self.evaluate(belief).jacobian
        return Evaluation(residual, j, len(residual), 0, {"a": slice(0, len(residual))}, {}, 1)


def start() -> Belief:
    belief = plain_belief(2)
    return belief.at(START)


def test_a_swing_is_fitted() -> None:
    solution = minimise(Toy(), start(), tolerance=1e-8, relative_tolerance=0.0)
    assert solution.converged
    np.testing.assert_allclose(solution.belief.coordinates, TRUTH, atol=1e-5)
    assert np.all(np.diff(solution.history) <= 0.0)


class Valley(Toy):
    """A straight valley whose floor is a million times flatter than its walls, seen from beside its end."""

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
        across, along = (belief.coordinates - TRUTH) @ np.array([[1.0, 1.0], [-1.0, 1.0]])
        j = np.array([[1e4, -1e4], [10.0, 10.0]])
        residual = np.array([1e4 * across, 10.0 * along])
        self.jacobians += jacobian
        return Evaluation(residual, j, 2, 0, {"a": slice(0, 2)}, {}, 1)


def test_a_narrow_valley_is_followed_to_its_end() -> None:
    # From where a damped step promises less than the relative tolerance of a cost of 8.
    begin = start().at(TRUTH + 0.2)
    solution = minimise(Valley(), begin, relative_tolerance=1e-2)
    assert solution.converged
    np.testing.assert_allclose(solution.belief.coordinates, TRUTH, atol=1e-2)


def test_secant_steps_save_jacobians(monkeypatch: pytest.MonkeyPatch) -> None:
    with_secants, without = Toy(), Toy()
    tight = {"tolerance": 1e-8, "relative_tolerance": 0.0}
    minimise(with_secants, start(), **tight)
    monkeypatch.setattr(levenberg_marquardt, "SECANTS", 0)
    solution = minimise(without, start(), **tight)
    np.testing.assert_allclose(solution.belief.coordinates, TRUTH, atol=1e-5)
    assert with_secants.jacobians < without.jacobians


def test_the_end_is_judged_by_a_fresh_jacobian() -> None:
    toy = Toy()
    solution = minimise(toy, start(), tolerance=1e-8, relative_tolerance=0.0)
    x = solution.belief.coordinates
    np.testing.assert_allclose(solution.evaluation.jacobian, -slope(swing, x) / SIGMA, rtol=1e-6, atol=1e-6)


def test_the_secant_jacobian_explains_the_step_and_leaves_the_rest() -> None:
    random = np.random.default_rng(1)
    jacobian, before, after = random.normal(size=(5, 3)), random.normal(size=5), random.normal(size=5)
    step = np.array([0.3, -0.1, 0.0])
    found = damped_step.secant(jacobian, before, after, step, np.ones(3))
    np.testing.assert_allclose(found @ step, after - before, atol=1e-12)
    across = np.array([0.1, 0.3, 0.7])  # at right angles to the step
    np.testing.assert_allclose(found @ across, jacobian @ across, atol=1e-12)


def test_a_step_into_what_cannot_be_simulated_is_shortened() -> None:
    # The first full step from this side overshoots the limit, which lies just beyond the truth.
    toy = Toy(limit=TRUTH[0] + 0.02)
    solution = minimise(toy, start().at(np.log([3e4, 1.3e3])), tolerance=1e-8, relative_tolerance=0.0)
    np.testing.assert_allclose(solution.belief.coordinates, TRUTH, atol=1e-4)


class Lacking(Toy):
    """A swing beside one that the model lacks."""

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
        found = super().evaluate(belief, jacobian=jacobian)
        return replace(found, residual=found.residual + 20.0 * np.sin(40.0 * TIME))


def test_a_gross_misfit_is_not_fitted_to_its_last_digits() -> None:
    tight = {"tolerance": 1e-8, "relative_tolerance": 0.0}
    far = start()
    whole = minimise(Lacking(), far, **tight)
    left = whole.evaluation.misfit
    assert whole.converged and left > 10.0
    sooner = minimise(Lacking(), far, gross=0.9 * left, **tight)
    assert not sooner.converged and "gross" in sooner.reason
    # It went on as long as that helped, and what is not gross is fitted to the end.
    assert 1 < len(sooner.history) - 1 < len(whole.history) - 1
    before, last = np.sqrt(sooner.history[-2:])
    assert last > levenberg_marquardt.HARDLY * before > levenberg_marquardt.HARDLY * last
    assert minimise(Lacking(), far, gross=2.0 * np.sqrt(whole.history[0]), **tight).history == whole.history


def test_a_gross_misfit_is_not_dwelt_on() -> None:
    tight = {"tolerance": 1e-8, "relative_tolerance": 0.0}
    whole = minimise(Lacking(), start(), **tight)
    assert len(whole.history) > 3
    left = whole.evaluation.misfit
    ended = minimise(Lacking(), start(), dwell=(1, 0.5 * left), **tight)
    assert ended.history == whole.history[:2] and not ended.converged and "gross" in ended.reason
    # What is no longer gross by then is fitted to its end.
    first = minimise(Lacking(), start(), iterations=1, **tight).evaluation.misfit
    on = minimise(Lacking(), start(), dwell=(1, 1.01 * first), **tight)
    assert on.history == whole.history and on.converged


def test_an_iteration_that_brings_too_little_is_the_last() -> None:
    asked: list[bool] = []

    class Counting(Lacking):
        def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
            asked.append(jacobian)
            return super().evaluate(belief, jacobian=jacobian)

    tight = {"tolerance": 1e-8, "relative_tolerance": 0.0}
    whole = minimise(Lacking(), start(), **tight).history
    falls = 1.0 - np.array(whole[1:]) / np.array(whole[:-1])
    assert falls[0] > 0.1 > 1e-3 > falls[-1]
    last = int(np.argmax(falls < 1e-3))
    ended = minimise(Counting(), start(), least=1e-3, **tight)
    assert ended.history == whole[: last + 2] and not ended.converged
    assert "too little" in ended.reason
    # Its Jacobian is there for who asks, once.
    assert asked.count(True) == last + 1
    assert np.any(ended.evaluation.jacobian) and ended.evaluation.jacobian is ended.evaluation.jacobian
    assert asked.count(True) == last + 2


def test_what_is_known_of_the_start_is_not_computed_again() -> None:
    asked: list[Belief] = []

    class Counting(Toy):
        def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
            asked.append(belief)
            return super().evaluate(belief, jacobian=jacobian)

    far = start()
    whole = minimise(Counting(), far)
    count = len(asked)
    again = minimise(Counting(), far, known=Toy().evaluate(far))
    assert (again.history, again.reason) == (whole.history, whole.reason)
    assert len(asked) - count == count - 1


def test_what_is_hopeless_is_not_differentiated_again() -> None:
    asked: list[bool] = []

    class Counting(Lacking):
        def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
            asked.append(jacobian)
            return super().evaluate(belief, jacobian=jacobian)

    far = start()
    left = minimise(Lacking(), far).evaluation.chi_square
    first = minimise(Lacking(), far, iterations=1)
    asked.clear()
    ended = minimise(Counting(), far, hopeless=0.9 * left)
    assert asked.count(True) == 1 and not ended.converged and "hopeless" in ended.reason
    assert np.array_equal(ended.evaluation.residual, first.evaluation.residual)
    assert ended.history == first.history
    # Only what is beyond the bound ends so.
    on = minimise(Lacking(), far, hopeless=10.0 * first.evaluation.chi_square)
    assert on.evaluation.chi_square < 1.01 * left


# ---- Jacobians of another grid ----------------------------------------------------------------
class Coarse(Toy):
    """A swing that is a little slower, as on a coarser grid."""

    def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
        return super().evaluate(belief.at(belief.coordinates - [0.05, 0.0]), jacobian=jacobian)


def test_the_jacobians_of_a_coarser_grid_lead_near_the_minimum() -> None:
    alone, fine, coarse = Toy(), Toy(), Coarse()
    tight = {"tolerance": 1e-8, "relative_tolerance": 0.0}
    minimise(alone, start(), **tight)
    belief = approached(fine, coarse, start(), **tight)
    assert fine.jacobians == 0 < coarse.jacobians and coarse.forwards == 0
    np.testing.assert_allclose(belief.coordinates, TRUTH, atol=1e-3)
    solution = minimise(fine, belief, **tight)
    np.testing.assert_allclose(solution.belief.coordinates, TRUTH, atol=1e-5)
    assert 0 < fine.jacobians < alone.jacobians


def test_lent_jacobians_that_hardly_help_are_no_longer_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    class Astray(Lacking):
        """Far from the truth at its best, so that every iteration brings ever less."""

    def lent(leads: float) -> tuple[int, float]:
        monkeypatch.setattr(borrowed_jacobians, "LEADS", leads)
        jacobian_problem = Coarse()
        found = approached(Astray(), jacobian_problem, start(), tolerance=1e-8, relative_tolerance=0.0)
        return jacobian_problem.jacobians, Lacking().evaluate(found).cost

    (few, near), (many, best) = lent(1e-2), lent(0.0)
    assert few < many and best <= near < 1.01 * best


def test_a_lender_that_breaks_down_loses_nothing() -> None:
    class Breaking(Toy):
        good = 0

        def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
            if self.jacobians == self.good:
                raise SimulationError("too soft for this grid")
            return super().evaluate(belief, jacobian=jacobian)

    before = Toy().evaluate(start()).cost
    for good, share in ((0, 1.0), (1, 0.5)):
        jacobian_problem = Breaking()
        jacobian_problem.good = good
        found = approached(Toy(), jacobian_problem, start())
        assert Toy().evaluate(found).cost <= share * before
    with pytest.raises(SimulationError):
        approached(Toy(limit=-np.inf), Coarse(), start())


def test_a_lender_of_other_frames_is_refused() -> None:
    class Shorter(Toy):
        def evaluate(self, belief: Belief, *, jacobian: bool = True) -> Evaluation:
            whole = super().evaluate(belief, jacobian=jacobian)
            return replace(whole, residual=whole.residual[:-3], slopes=whole.jacobian[:-3])

    with pytest.raises(ValueError, match="expected the same frames"):
        approached(Toy(), Shorter(), start())
