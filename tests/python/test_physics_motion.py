"""What every simulation must keep: free fall, momentum, energy, and the same motion in a turned scene."""

from __future__ import annotations

import numpy as np
import pytest

from bar_capture import DOWN, bar_belief, bar_capture, turned
from mphygs.capture.format import Capture
from mphygs.capture.holds import Load
from mphygs.model.belief import Belief
from mphygs.simulate.body import core_model
from mphygs.simulate.discretisation import discretise
from mphygs.simulate.fields import core_inputs
from mphygs.simulate.prediction import Predictor, Settings

SPACING = 0.01


def predictor(capture: Capture, spacing: float = SPACING) -> Predictor:
    return Predictor(capture, capture.sequence("a"), Settings(spacing, dtype="float64"))


class Rollout:
    """Node states of a free or held bar, and what is computed from them."""

    def __init__(
        self, capture: Capture, belief: Belief, *, velocity: object = None, seconds: float = 0.2
    ) -> None:
        boxes = np.array([hold.box for hold in capture.sequence("a").held]).reshape(-1, 2, 3)
        self.body = discretise(capture, boxes, SPACING)
        self.model = core_model(
            self.body, active=(), dtype=np.float64, law="neo-hookean", threads=1, memory_budget=1 << 20
        )
        self.fields = core_inputs(belief, self.body)
        stiffness, _ = self.model.largest_rates(self.fields)
        step = 0.3 * 2.0 / np.sqrt(stiffness)
        frames = 40
        count = int(np.ceil(seconds / frames / step))
        schedule = {
            "steps": np.full(frames, count, np.int32),
            "dt": np.full(frames, seconds / frames / count),
        }
        run = dict(self.fields)
        if velocity is not None:
            run["velocity0"] = velocity(self.model.node_positions)
        if len(boxes):
            pose = np.zeros((1, frames * count + 1, 12))
            pose[..., [0, 4, 8]] = 1.0
            run["pose"] = pose
        self.displacement, self.velocity = self.model.simulate(run, schedule)
        self.mass = self.model.node_mass(self.fields)
        self.position = self.model.node_positions + self.displacement

    def deformation(self) -> np.ndarray:
        """(F + 1, N, 3, 3) at the quadrature points."""
        q = self.body.quadrature
        node, _, gradient = self.model.weights(q.points.reshape(-1, 3), self.body.point_cell)
        return np.einsum("tmkc,mkj->tmcj", self.displacement[:, node], gradient) + np.eye(3)

    def elastic_energy(self) -> np.ndarray:
        """(F + 1,) [J]."""
        f = self.deformation()
        mu, lame, volume = (self.fields[n].ravel() for n in ("mu", "lambda", "stress_volume"))
        log_j = np.log(np.linalg.det(f))
        return ((mu / 2 * ((f * f).sum((2, 3)) - 3) - mu * log_j + lame / 2 * log_j**2) * volume).sum(1)

    def kinetic_energy(self) -> np.ndarray:
        return 0.5 * np.einsum("n,tnc,tnc->t", self.mass, self.velocity, self.velocity)


def test_free_fall_is_exact() -> None:
    capture = bar_capture(held=None, frames=11, fps=50.0)
    fall = predictor(capture).predict(bar_belief(capture))
    times, step = fall.frames / 50.0, fall.dt
    # Symplectic Euler: the velocity is exact, the position by half a substep ahead.
    expected = 0.5 * DOWN * (times * (times + step))[:, None]
    moved = fall.position - fall.position[0]
    np.testing.assert_allclose(moved, np.broadcast_to(expected[:, None], moved.shape), atol=1e-12)
    np.testing.assert_allclose(
        fall.velocity, np.broadcast_to((DOWN * times[:, None])[:, None], moved.shape), atol=1e-11
    )


def test_momentum_of_a_free_spinning_deforming_bar() -> None:
    capture = bar_capture(held=None, lengths=(0.03, 0.03), gravity=np.zeros(3))
    belief = bar_belief(capture, youngs_modulus=(2e4, 1e4), density=(1000.0, 700.0))
    spin, drift = np.array([3.0, -5.0, 20.0]), np.array([0.3, -0.2, 0.1])
    run = Rollout(capture, belief, velocity=lambda x: np.cross(spin, x) + drift)
    assert run.elastic_energy().max() > 1e-2 * run.kinetic_energy()[0], "the bar should deform"
    linear = np.einsum("n,tnc->tc", run.mass, run.velocity)
    angular = np.einsum("n,tnc->tc", run.mass, np.cross(run.position, run.velocity))
    np.testing.assert_allclose(
        linear, np.broadcast_to(linear[0], linear.shape), atol=1e-12 * np.abs(linear[0]).max()
    )
    np.testing.assert_allclose(
        angular, np.broadcast_to(angular[0], angular.shape), atol=1e-11 * np.abs(angular[0]).max()
    )


def test_energy_of_the_undamped_swing_does_not_drift() -> None:
    capture = bar_capture()
    belief = bar_belief(capture, youngs_modulus=3e4, poissons_ratio=0.35)
    run = Rollout(capture, belief, seconds=2.0)
    elastic = run.elastic_energy()
    fallen = -np.einsum("n,tnc,c->t", run.mass, run.displacement, capture.gravity)
    total = (run.kinetic_energy() + elastic + fallen) / elastic.max()
    assert np.ptp(fallen / elastic.max()) > 1.0, "the bar should swing"
    # Symplectic Euler lets the energy breathe with the substep, and keeps its mean: 1e-5 in 2 s.
    assert np.ptp(total) < 2e-2
    assert abs(total[-10:].mean() - total[1:11].mean()) < 1e-3


def test_a_load_that_ends_has_given_its_impulse_and_no_more() -> None:
    force = np.array([0.003, 0.0, 0.006])
    everything = np.array([[-1.0, -1, -1], [1, 1, 1]])
    capture = bar_capture(
        held=None, gravity=np.zeros(3), frames=9, fps=50.0, loads=(Load(everything, force, 2, 6),)
    )
    belief = bar_belief(capture, youngs_modulus=2e4)
    mass = 1000.0 * capture.parts[0].volume
    speed = predictor(capture).predict(belief, substep=1e-3).velocity.mean(1)
    times = np.clip(np.arange(9) - 2, 0, 4) / 50.0
    # Spread evenly over the body, it moves all points alike.
    np.testing.assert_allclose(speed, times[:, None] * force / mass, atol=1e-5 * np.abs(speed).max())


TURNS = {
    "axes change places": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "quarter turn": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "upside down": np.diag([1.0, -1, -1]),
}


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS.keys())
@pytest.mark.parametrize("prestress", ["off", "paper", "equilibrium"])
def test_a_turned_scene_moves_the_same(turn: np.ndarray, prestress: str) -> None:
    pull = Load(np.array([[0.05, -1, -1], [1, 1, 1]]), np.array([0.01, 0.02, 0.01]), 2)
    rest = "equilibrium" if prestress == "equilibrium" else "stress-free"
    capture = bar_capture(lengths=(0.03, 0.03), held=0.01, frames=8, loads=(pull,), rest=rest)
    other = turned(capture, turn)
    motions = []
    for one in (capture, other):
        belief = bar_belief(one, youngs_modulus=(4e4, 2e4), prestress=prestress)
        belief = belief.with_effect("viscosity", {"eta": 2.0}).with_effect("air_drag", {"c_d": 1.0})
        motions.append(predictor(one).predict(belief, substep=3e-4).position)
    assert np.abs(motions[0] - motions[0][0]).max() > 1e-3
    np.testing.assert_allclose(motions[0] @ turn.T, motions[1], atol=1e-9)


def test_a_scene_turned_by_any_angle_moves_the_same_up_to_the_grid() -> None:
    capture = bar_capture(held=None, gravity=np.zeros(3), lengths=(0.06,))
    angle = 0.6
    tilt = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    spin = np.array([0.0, 0.0, 25.0])
    stretches = []
    for one in (capture, turned(capture, tilt)):
        run = Rollout(
            one, bar_belief(one, youngs_modulus=2e4), velocity=lambda x: np.cross(spin, x), seconds=0.1
        )
        stretches.append(run.elastic_energy())
    assert stretches[0].max() > 1e-5
    np.testing.assert_allclose(stretches[1], stretches[0], atol=0.1 * stretches[0].max())
