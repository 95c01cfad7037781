"""The adjoint's gradient of a fit's cost, and the optimisers that follow it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.capture.format import Capture
from mphygs.capture.holds import Load
from mphygs.compare.autoregression import Autoregression
from mphygs.compare.noise import Observation
from mphygs.compare.whitening import NoiseModel, Whitener
from mphygs.fit.gradient_optimisers import cost_and_gradient, minimise_by_gradient
from mphygs.fit.levenberg_marquardt import covariance, minimise
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief, Parameter
from mphygs.simulate.errors import SimulationError
from mphygs.simulate.prediction import Predictor, Settings

SIGMA = 1e-4
SETTINGS = Settings(0.012, dtype="float64", workers=1)
FREE = ("part0.youngs_modulus", "part1.youngs_modulus", "part1.density")
CORRELATED = NoiseModel(
    sigma=np.asarray(SIGMA), source="made up", correlated_share=np.asarray(0.5),
    correlation=Autoregression((0.7,)), common_sigma=np.full(3, 0.3 * SIGMA),
    common_correlation=Autoregression((0.4,)),
)  # fmt: skip


def problem_for(
    capture: Capture, truth: Belief, noise: NoiseModel | None = None, gaps: bool = True
) -> Problem:
    """A fit of markers that the truth made, with noise and some values missing."""
    recording = capture.sequence("a")
    predictor = Predictor(capture, recording, SETTINGS)
    position = predictor.predict(truth, substep=3e-4).position
    random = np.random.default_rng(3)
    position = position + SIGMA * random.standard_normal(position.shape)
    if gaps:
        position[random.random(position.shape[:2]) < 0.1] = np.nan
    noise = noise or NoiseModel.white(SIGMA, "stated")
    observation = Observation(position, noise, np.ones(position.shape[1]))
    return Problem(
        capture, SETTINGS, {"a": (1, recording.frames)}, {"a": observation}, {"a": predictor}, 3e-4
    )


def moved(belief: Belief, by: Sequence[float]) -> Belief:
    return belief.at(belief.coordinates + np.resize(np.asarray(by, float), len(belief.free)))


def free_of(belief: Belief, keys: Sequence[str]) -> Belief:
    return replace(belief, parameters=tuple(replace(p, free=p.key in keys) for p in belief.parameters))


def test_whitening_transposed_is_the_adjoint() -> None:
    random = np.random.default_rng(0)
    whitener = Whitener(CORRELATED, random.random((9, 4)) > 0.2)
    x, y = random.standard_normal((9, 4, 3)), random.standard_normal(whitener.row_count)
    assert whitener.whiten(x) @ y == pytest.approx((x * whitener.whiten_transposed(y)).sum(), rel=1e-12)
    with pytest.raises(ValueError, match="3 rows: expected"):
        whitener.whiten_transposed(np.zeros(3))


@pytest.mark.parametrize("prestress", ["off", "equilibrium"])
@pytest.mark.parametrize("noise", [None, CORRELATED], ids=["white", "correlated"])
def test_the_gradient_is_that_of_the_jacobian(prestress: str, noise: NoiseModel | None) -> None:
    rest = "equilibrium" if prestress == "equilibrium" else "stress-free"
    wave = 0.004 * np.sin(np.linspace(0, 3, 8))[:, None] * [0.0, 1.0, 0.5]
    beside = np.array([[0.05, 0.01, 0.026], [0.03, 0.01, 0.01], [-0.002, 0.01, 0.02], [0.048, 0.026, 0.01]])
    pull = Load(np.array([[0.04, -1, -1], [1, 1, 1]]), np.array([0.0, 0.01, 0.0]), 2)
    capture = bar_capture(
        lengths=(0.024, 0.024), frames=8, motion=wave, rest=rest, markers_at=beside, loads=(pull,)
    )  # fmt: skip
    belief = bar_belief(
        capture, youngs_modulus=(4e4, 2e4), free=FREE, prestress=prestress, known_mass=0.02
    ).with_effect("viscosity", {"eta": 2.0})
    belief = belief.with_effect("air_drag", {"c_d": 0.5}).with_effect(
        "relaxation", {"ratio": 0.2, "tau": 0.05}
    )
    belief = belief.with_effect("attached_mass", {"m": 1e-3}, {"place": [0.04, 0.01, 0.01]})
    belief = belief.with_parameter("part0.youngs_modulus", prior_mean=np.log(5e4), prior_std=0.3)
    problem = problem_for(capture, belief, noise)
    trial = moved(belief, [0.1, -0.2, 0.05])
    evaluation = problem.evaluate(trial)
    cost, gradient = cost_and_gradient(problem, trial)
    assert cost == pytest.approx(evaluation.cost, rel=1e-12)
    assert (np.abs(gradient) > 1e-6).all()
    np.testing.assert_allclose(gradient, evaluation.jacobian.T @ evaluation.residual, rtol=1e-6)


def test_the_gradient_by_faults_and_release_is_a_difference() -> None:
    capture = bar_capture(lengths=(0.048,), frames=9)
    capture = replace(capture, sequences=(replace(capture.sequence("a"), release=2),))
    belief = bar_belief(capture, youngs_modulus=3e4, free=("part0.youngs_modulus",))
    shift = Parameter("a.release_shift", 0.001, "s", -0.02, 0.02, scale=0.02, prior_std=0.02)
    belief = replace(belief, parameters=(*belief.parameters, shift))
    for name, values in (
        ("time_offset", {"offset": 0.004}), ("length_scale", {"scale": 0.01}),
        ("frame_drift", {"v_x": 1e-3, "w_y": 0.02, "w_z": 0.01}),
    ):  # fmt: skip
        belief = belief.with_effect(name, values)
    problem = problem_for(capture, belief)
    trial = moved(belief, [0.1, 0.05, -0.1, 0.2])
    # The simulation's own unknown feels every fault on its way to the markers; those of the faults are the
    # Jacobian's, which the diagnosis tests.
    key = "part0.youngs_modulus"
    index = [p.key for p in trial.free].index(key)
    step = np.zeros(len(trial.free))
    step[index] = 1e-5
    sides = [problem.evaluate(trial.at(trial.coordinates + s * step), jacobian=False).cost for s in (1, -1)]
    _, gradient = cost_and_gradient(problem, trial)
    assert gradient[index] == pytest.approx((sides[0] - sides[1]) / 2e-5, rel=1e-4)


def small_fit(**options: object) -> tuple[Problem, Belief]:
    capture = bar_capture(lengths=(0.024, 0.024), frames=8)
    truth = bar_belief(capture, youngs_modulus=(4e4, 2e4), free=FREE, **options)
    truth = truth.with_effect("viscosity", {"eta": 3.0})
    problem = replace(problem_for(capture, truth), substep=5e-4)
    start = moved(truth.with_parameter("viscosity.eta", value=1.0), [0.4, -0.3, 0.2, 0.0])
    return problem, start


@pytest.mark.parametrize(
    ("method", "iterations", "excess"),
    [pytest.param("adam", 150, 0.5, marks=pytest.mark.slow), ("lbfgs", 30, 0.05)],
)
def test_both_methods_reach_the_gauss_newton_minimum(method: str, iterations: int, excess: float) -> None:
    problem, start = small_fit()
    exact = minimise(problem, start, tolerance=1e-6, relative_tolerance=1e-9)
    told: list[int] = []
    found = minimise_by_gradient(
        problem, start, method=method, iterations=iterations, tolerance=1e-3, relative_tolerance=1e-6,
        report=lambda iteration, cost, belief: told.append(iteration),
    )  # fmt: skip
    assert problem.evaluate(start).cost > 10 * exact.evaluation.cost, (
        "the start should be far from the minimum"
    )
    assert found.evaluation.cost == pytest.approx(exact.evaluation.cost, abs=excess)
    spread = np.sqrt(np.diag(covariance(exact.evaluation)))
    # A cost so much above its minimum is within sqrt(2 excess) standard deviations of it in every direction.
    away = np.abs(found.belief.coordinates - exact.belief.coordinates)
    assert (away < 1.05 * np.sqrt(2 * excess) * spread).all()
    np.testing.assert_allclose(np.sqrt(np.diag(covariance(found.evaluation))), spread, rtol=0.1)
    assert list(found.history) == sorted(found.history, reverse=True) and told[0] == 1
    assert found.converged == (found.reason == "converged")


def test_a_bound_is_kept() -> None:
    problem, start = small_fit()
    start = start.with_parameter("viscosity.eta", upper=2.0)
    exact = minimise(problem, start, tolerance=1e-6, relative_tolerance=1e-9)
    assert exact.belief["viscosity.eta"].value == pytest.approx(2.0)
    found = minimise_by_gradient(problem, start, method="lbfgs", iterations=40, tolerance=1e-3)
    assert list(found.history) == sorted(found.history, reverse=True)
    assert [p.key for p in found.belief.free] == [p.key for p in start.free]
    assert found.belief["viscosity.eta"].value == pytest.approx(2.0, rel=1e-3)
    assert found.evaluation.cost == pytest.approx(exact.evaluation.cost, rel=1e-2)


def test_a_step_into_what_cannot_be_simulated_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    problem, start = small_fit()
    whole = Predictor.timeline
    refused = []

    def timeline(self: Predictor, belief: Belief, *given: object) -> object:
        if belief["part0.youngs_modulus"].value > 4.2e4:
            refused.append(belief)
            raise SimulationError("too stiff for this test")
        return whole(self, belief, *given)

    monkeypatch.setattr(Predictor, "timeline", timeline)
    start = start.with_parameter("part0.youngs_modulus", value=2.5e4)
    first = problem.evaluate(start).cost
    found = minimise_by_gradient(problem, start, method="lbfgs", iterations=10)
    assert refused and found.evaluation.cost < 0.5 * first


def test_an_unknown_method_is_refused() -> None:
    problem, start = small_fit()
    with pytest.raises(ValueError, match="method 'newton': expected one of adam, lbfgs"):
        minimise_by_gradient(problem, start, method="newton")
    with pytest.raises(ValueError, match="expected a belief with free parameters"):
        minimise_by_gradient(problem, free_of(start, ()), method="adam")
