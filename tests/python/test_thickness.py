"""Rods and shells whose thickness is not known: beside meshes of it, and what a fit knows then."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mphygs.capture.format import Capture, load_capture
from mphygs.capture.meshes import Part
from mphygs.capture.save import save_capture
from mphygs.fit.determined import determinations, information_of
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.run import capture_digest
from mphygs.fit.start import starting_belief
from mphygs.model.belief import Belief
from mphygs.simulate.held_material import HeldMaterial
from mphygs.simulate.modes import natural_modes
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.settings import IMPLICIT, Settings
from thin_meshes import held_capture, rod, strip

E, RHO, T = "part0.youngs_modulus", "part0.density", "part0.thickness"
SETTINGS = Settings(0.01, dtype="float64", workers=1, integrator=IMPLICIT)


def thin(kind: str, times: float = 1.0) -> Part:
    """A rod or a sheet, so many times as thick as usual, known to a tenth."""
    part = rod(radius=0.0015 * times) if kind == "rod" else strip(thickness=3e-4 * times)
    return replace(part, thickness_std=3e-4 if kind == "rod" else 3e-5)


def moved_capture(part: Part, **more: object) -> Capture:
    """Its hold goes up and comes to rest again within ten frames."""
    frames = 10
    motion = np.zeros((frames, 3))
    motion[:, 2] = 0.004 * (1.0 - np.cos(2 * np.pi * np.arange(frames) / (frames - 1)))
    return held_capture(
        [part], frames=frames, motion=motion, gravity=[0.0, 0.0, -9.81], fit=(0, frames), **more
    )


def belief_of(capture: Capture, times: float = 1.0, *, known_density: bool = True) -> Belief:
    belief = starting_belief(capture).with_parameter(E, value=9e8)
    belief = belief.with_parameter(RHO, value=1200.0, free=not known_density)
    return belief.with_parameter(T, value=times * belief[T].value)


@pytest.mark.parametrize("kind", ["rod", "shell"])
def test_a_thicker_one_swings_and_weighs_as_its_mesh_does(kind: str) -> None:
    def looked_at(mesh: float, times: float) -> tuple[np.ndarray, np.ndarray]:
        capture = moved_capture(thin(kind, mesh))
        predictor = Predictor(capture, capture.sequence("a"), replace(SETTINGS, spacing=0.005))
        belief = belief_of(capture, times)
        squared = natural_modes(predictor, belief, 2).squared
        held = HeldMaterial.of(predictor.body, 0, capture.sequence("a").held[0], 60.0)
        return np.sqrt(squared), held.wrench(belief, np.array([0.0]))[0, 0]

    (usual, weight), (told, heavier), (made, expected) = (
        looked_at(mesh, times) for mesh, times in ((1.0, 1.0), (1.0, 1.2), (1.2, 1.0))
    )
    np.testing.assert_allclose(told / usual, 1.2, rtol=1e-6)
    np.testing.assert_allclose(made / usual, 1.2, rtol=4e-3)
    assert heavier[2] == pytest.approx(expected[2], rel=1e-3)
    assert heavier[2] / weight[2] == pytest.approx(1.44 if kind == "rod" else 1.2, rel=1e-6)


@pytest.mark.parametrize("kind", ["rod", "shell"])
def test_slopes_by_the_thickness_are_those_of_differences_and_of_the_adjoint(kind: str) -> None:
    capture = moved_capture(thin(kind), rest="equilibrium")
    predictor = Predictor(capture, capture.sequence("a"), SETTINGS)
    belief = belief_of(capture, 1.05)
    keys = [p.key for p in belief.free]
    own = predictor.predict(belief, keys=keys).jacobian[..., keys.index(T)]
    step = 1e-4 * (np.array(keys) == T)
    up, down = (predictor.predict(belief.at(belief.coordinates + s * step)).position for s in (1, -1))
    difference = (up - down) / 2e-4
    assert np.abs(own - difference).max() < 1e-3 * np.abs(difference).max()
    weights = np.random.default_rng(0).standard_normal(own.shape)
    gradient = predict_with_gradient(predictor, belief, lambda x: weights, keys=[T], last=10)[1]
    assert gradient[0] == pytest.approx((weights * own).sum(), rel=1e-5)


@pytest.mark.parametrize("kind", ["rod", "shell"])
def test_of_a_known_density_the_motion_tells_the_modulus_times_the_square(kind: str) -> None:
    """A tenth of the thickness is a fifth of E, which the prior alone says; E t^2 is told far better."""
    capture = moved_capture(thin(kind))
    belief = belief_of(capture)
    evaluation = Experiment.of(capture, SETTINGS).problem(0.01).evaluate(belief)
    known = covariance(evaluation)
    at = {p.key: k for k, p in enumerate(belief.free)}
    spread = np.sqrt(np.diag(known))
    of_thickness = capture.parts[0].thickness_std / belief[T].value
    assert spread[at[T]] == pytest.approx(of_thickness, rel=1e-2)
    assert spread[at[E]] == pytest.approx(2.0 * of_thickness, rel=3e-2)
    together = np.zeros(len(known))
    together[[at[E], at[T]]] = 1.0, 2.0
    assert np.sqrt(together @ known @ together) < 0.1 * spread[at[E]]
    told = determinations(belief.free, information_of(evaluation, len(at)), known)
    assert not told[T].determined and not told[E].determined
    assert T in told[E].note


def test_a_known_mass_tells_a_thickness_of_known_density() -> None:
    capture = moved_capture(thin("rod"))
    belief = belief_of(capture)
    belief = replace(belief, known_mass=1200.0 * capture.parts[0].volume)
    problem = Experiment.of(capture, SETTINGS).problem(0.01)
    residual, slope = problem.prior_rows(belief)
    assert residual[-1] == pytest.approx(0.0, abs=1e-9)
    step = 1e-6 * (np.array([p.key for p in belief.free]) == T)
    ahead = problem.prior_rows(belief.at(belief.coordinates + step))[0][-1]
    assert slope[-1] @ step == pytest.approx(ahead, rel=1e-4)
    # Two thousandths of the mass are one of the thickness.
    spread = np.sqrt(np.diag(covariance(problem.evaluate(belief))))
    assert spread[[p.key for p in belief.free].index(T)] == pytest.approx(1e-3, rel=1e-2)


def test_what_is_known_of_a_thickness_is_kept_with_a_capture(tmp_path: Path) -> None:
    capture = moved_capture(thin("shell"))
    save_capture(capture, tmp_path)
    again = load_capture(tmp_path)
    assert again.parts[0].thickness_std == 3e-5 and again.parts[0].shape == "shell"
    surely = replace(capture, parts=(replace(capture.parts[0], thickness_std=0.0),))
    solid = replace(capture, parts=(replace(surely.parts[0], shape="solid"),))
    assert T not in starting_belief(surely)
    assert len({capture_digest(c) for c in (capture, surely, solid)}) == 3
