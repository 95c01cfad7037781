"""Motion under further node forces: derivatives, and the linear model of the natural modes."""

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from force_example import shaken_bar, soft_belief
from mphygs.simulate.forced_motion import ForcedSequence
from mphygs.simulate.modes import natural_modes
from mphygs.simulate.prediction import Predictor, Settings

FREE = ("part0.youngs_modulus", "part1.density")


@pytest.fixture(scope="module")
def forced() -> ForcedSequence:
    capture = shaken_bar(8, markers=12)
    settings = Settings(0.015, dtype="float64", workers=1)
    return ForcedSequence(Predictor(capture, capture.sequences[0], settings), 8)


@pytest.mark.parametrize("faulty", [False, True], ids=["plain", "late, of another scale"])
def test_gradient_and_tangent_follow_differences(forced: ForcedSequence, faulty: bool) -> None:
    belief = soft_belief(forced.predictor.capture, free=FREE)
    if faulty:
        belief = belief.with_effect("time_offset", {"offset": 0.4 / forced.predictor.recording.fps})
        belief = belief.with_effect("length_scale", {"scale": 0.1})
    axes = np.eye(len(belief.free))[[[p.key for p in belief.free].index(key) for key in FREE]]
    random = np.random.default_rng(0)
    shape = (8, forced.model(belief).node_count, 3)
    force, direction = 1e-3 * random.standard_normal((2, *shape))
    motion = forced.run(belief, force)
    weight = random.standard_normal(motion.position.shape)
    by_force, slopes = forced.gradient(motion, weight, FREE)
    assert faulty or not by_force[0].any(), "nothing acts before the first frame, where its clock is right"
    # The substep is of the belief: held fixed, or a difference would move the steps as well.
    fixed = forced.predictor.stable_substep(belief)
    forced.predictor.stable_substep = lambda _belief: fixed
    try:
        for step, at in ((1e-3, 0), (1e-5, 1), (1e-5, 2)):
            ends = []
            for sign in (1.0, -1.0):
                moved = belief.at(belief.coordinates + sign * step * axes[at - 1]) if at else belief
                pushed = force + sign * step * direction if not at else force
                ends.append(forced.run(moved, pushed).position)
            change = (ends[0] - ends[1]) / (2 * step)
            gradient = np.vdot(by_force, direction) if not at else slopes[at - 1]
            assert gradient == pytest.approx(np.vdot(weight, change), rel=1e-5)
            tangent = forced.tangents(motion, [direction], FREE)[..., at]
            np.testing.assert_allclose(tangent, change, atol=1e-4 * np.abs(change).max())
    finally:
        del forced.predictor.stable_substep


def test_lowest_mode_is_the_cantilever_s() -> None:
    capture = bar_capture(lengths=(0.12,), side=0.012, depth=0.018, gravity=np.zeros(3))
    belief = bar_belief(capture, youngs_modulus=1e5, density=1000.0, poissons_ratio=0.0)
    predictor = Predictor(capture, capture.sequences[0], Settings(0.006, workers=1))
    modes = natural_modes(predictor, belief, 6)
    np.testing.assert_allclose(
        np.einsum("nci,ncj,n->ij", modes.shape, modes.shape, modes.mass), np.eye(6), atol=1e-6
    )
    # Euler and Bernoulli: omega = 1.875^2 / L^2 sqrt(E I / (rho A)), I / A = h^2 / 12.
    for number, thickness in enumerate((0.012, 0.018)):
        omega = 1.8751**2 / 0.12**2 * np.sqrt(1e5 / 1000.0 * thickness**2 / 12.0)
        assert np.sqrt(modes.squared[number]) == pytest.approx(omega, rel=0.06)
    assert np.abs(modes.damping).max() < 1e-3
    damped = natural_modes(predictor, belief.with_effect("mass_damping", {"alpha": 2.0}), 6)
    np.testing.assert_allclose(damped.damping, 2.0 * np.eye(6), atol=1e-3)


def test_modes_tell_what_a_force_does(forced: ForcedSequence) -> None:
    belief = soft_belief(forced.predictor.capture)
    modes = natural_modes(forced.predictor, belief, 24)
    force = np.zeros((8, len(modes.mass), 3))
    force[2:5, :, 1] = modes.mass
    motion = forced.run(belief, np.zeros_like(force))
    exact = forced.tangents(motion, [force])[..., 0]
    carriers = forced.predictor.carriers
    free, node, weight = carriers.free, carriers.index, carriers.value
    modal = np.einsum("tnc,ncj->tj", force, modes.shape)[1:, :, None]
    amplitude = modes.response(modal, motion.spans)[..., 0]
    found = np.einsum("mk,mkcj,tj->tmc", weight, modes.shape[node], amplitude)
    assert np.linalg.norm(found - exact[:, free]) < 0.2 * np.linalg.norm(exact[:, free])


def test_many_directions_are_those_of_each_alone(forced: ForcedSequence) -> None:
    """More than the core carries at once: shared out to several runs, side by side where there are cores."""
    belief = soft_belief(forced.predictor.capture, free=FREE)
    shape = (8, forced.model(belief).node_count, 3)
    forces = list(1e-3 * np.random.default_rng(1).standard_normal((19, *shape)))
    assert len(forces) > forced.predictor.transfer.batch
    motion = forced.run(belief, np.zeros(shape))
    alone = np.concatenate([forced.tangents(motion, [force]) for force in forces], axis=-1)
    assert np.abs(alone).max(axis=(0, 1, 2)).min() > 0.0
    found = forced.tangents(motion, forces, FREE)
    np.testing.assert_allclose(found[..., : len(forces)], alone, rtol=1e-9, atol=1e-15)
    abreast = ForcedSequence(forced.predictor.twin(2), 8)
    assert np.array_equal(abreast.tangents(motion, forces, FREE), found)
