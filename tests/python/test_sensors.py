"""Forces at holds and accelerations of points: closed forms, derivatives, and what they tell of a bar."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import DOWN, bar_belief, bar_capture
from mphygs.capture.format import Capture
from mphygs.capture.motions import ramp
from mphygs.capture.rotation import quaternion_from_rotation_vector
from mphygs.fit.experiment import Experiment
from mphygs.fit.gradient_optimisers import cost_and_gradient
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.prediction_gradient import predict_with_gradient
from mphygs.simulate.reactions import reaction_weights
from mphygs.simulate.settings import MLS, TOTAL_LAGRANGIAN, Settings
from sensor_example import HELD, SIDE, acceleration_at, force_at, moved_bar, with_sensors
from thin_meshes import held_capture, rod

LENGTH, DENSITY = 0.06, 1000.0
FREE = ("part0.youngs_modulus", "part1.density", "part0.density", "part1.poissons_ratio")


def predictor_of(capture: Capture, spacing: float = 0.007, **options: object) -> Predictor:
    """Of its only sequence."""
    return Predictor(capture, capture.sequences[0], Settings(spacing, workers=1, **options))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_resting_bar_weighs_on_its_hold(dtype: str) -> None:
    frames = 6
    capture = bar_capture(lengths=(LENGTH,), side=SIDE, held=HELD, rest="equilibrium", frames=frames, fps=100)
    tip = acceleration_at([LENGTH, 0.01, 0.01], frames, gravity=True)
    capture = with_sensors(capture, force_at(0, frames), tip)
    belief = bar_belief(capture, prestress="equilibrium", youngs_modulus=2e5, density=DENSITY)
    force, acceleration = predictor_of(capture, dtype=dtype).predict(belief).readings
    weight = DENSITY * (LENGTH + HELD) * SIDE**2 * DOWN
    middle = np.array([0.5 * (LENGTH - HELD), 0.5 * SIDE, 0.5 * SIDE])
    lever = middle - capture.sequences[0].held[0].box.mean(axis=0)
    scale = np.linalg.norm(weight)
    np.testing.assert_allclose(force.value[:, 0], np.tile(-weight, (frames, 1)), atol=1e-4 * scale)
    torque = np.tile(-np.cross(lever, weight), (frames, 1))
    np.testing.assert_allclose(force.value[:, 1], torque, atol=1e-4 * scale * np.linalg.norm(lever))
    np.testing.assert_allclose(acceleration.value[:, 0], np.tile(-DOWN, (frames, 1)), atol=2e-3 * 9.81)


def test_a_shaken_stiff_rod_needs_its_mass_times_its_acceleration() -> None:
    frames, fps, amplitude, omega = 50, 200.0, 1e-3, 2.0 * np.pi * 8.0
    axis = np.array([0.0, 0.6, 0.8])

    def course(times: np.ndarray) -> np.ndarray:
        return amplitude * ramp(times / 0.15) * np.sin(omega * times)

    times, step, part = np.arange(frames) / fps, 1e-5, rod(0.03)
    motion = course(times)[:, None] * axis
    capture = held_capture([part], frames=frames, fps=fps, gravity=np.zeros(3), motion=motion)
    capture = with_sensors(capture, force_at(0, frames))
    # The lowest frequency, about 460 Hz, is far above the shaking.
    belief = bar_belief(capture, youngs_modulus=1e9, density=DENSITY, prestress="off")
    (force,) = predictor_of(capture, dtype="float64").predict(belief).readings
    second = (course(times + step) - 2.0 * course(times) + course(times - step)) / step**2
    off = np.abs(force.value[1:-1, 0] - DENSITY * part.volume * second[1:-1, None] * axis).max()
    assert off < 0.01 * DENSITY * part.volume * np.abs(second).max()


def test_a_shaken_stiff_bar_needs_its_mass_times_its_acceleration() -> None:
    frames, fps, amplitude, omega = 50, 200.0, 1e-3, 2.0 * np.pi * 8.0
    axis = np.array([0.0, 0.6, 0.8])

    def course(times: np.ndarray) -> np.ndarray:
        return amplitude * ramp(times / 0.15) * np.sin(omega * times)

    times, step = np.arange(frames) / fps, 1e-5
    capture = bar_capture(
        lengths=(LENGTH,), side=SIDE, held=HELD, frames=frames, fps=fps, gravity=np.zeros(3),
        motion=course(times)[:, None] * axis,
    )  # fmt: skip
    places = [[LENGTH, 0.01, 0.01], [-0.5 * HELD, 0.01, 0.01]]
    capture = with_sensors(capture, force_at(0, frames), *(acceleration_at(at, frames) for at in places))
    # The lowest frequency, about 290 Hz, is far above the shaking.
    belief = bar_belief(capture, youngs_modulus=1e8, density=DENSITY).with_effect("viscosity", {"eta": 2e3})
    force, *accelerations = predictor_of(capture).predict(belief).readings
    second = (course(times + step) - 2.0 * course(times) + course(times - step)) / step**2
    expected = second[:, None] * axis
    largest, inner = np.abs(second).max(), slice(1, -1)
    mass = DENSITY * (LENGTH + HELD) * SIDE**2
    assert np.abs(force.value[inner, 0] - mass * expected[inner]).max() < 0.01 * mass * largest
    for reading in accelerations:
        assert np.abs(reading.value[inner, 0] - expected[inner]).max() < 0.01 * largest


def test_a_grip_on_nearly_all_of_a_bar_is_a_rigid_body() -> None:
    frames, fps, free, grip = 60, 100.0, 0.005, 0.05
    capture = bar_capture(lengths=(free,), side=SIDE, held=grip, frames=frames, fps=fps)
    times = np.arange(frames) / fps
    angle = 0.2 * np.sin(12.0 * times)
    hold = replace(
        capture.sequences[0].held[0],
        position=0.01 * np.sin(9.0 * times)[:, None] * [1.0, 0.5, -0.7],
        quaternion=quaternion_from_rotation_vector(angle[:, None] * [0.0, 1.0, 0.0]),
        box=np.array([[-grip, 0.0, 0.0], [0.0, SIDE, SIDE]]),
    )
    capture = replace(capture, sequences=(replace(capture.sequences[0], held=(hold,)),))
    capture = with_sensors(capture, force_at(0, frames))
    belief = bar_belief(capture, youngs_modulus=4e6, density=DENSITY).with_effect("viscosity", {"eta": 5e2})
    reading = predictor_of(capture, 0.005).predict(belief).readings[0].value[6:-6]
    # Newton and Euler for a box, about the centre of the hold's.
    lengths = np.array([grip + free, SIDE, SIDE])
    mass, centre = DENSITY * lengths.prod(), np.array([0.5 * (free - grip), 0.01, 0.01])
    c, s, one, zero = np.cos(angle), np.sin(angle), np.ones(frames), np.zeros(frames)
    turn = np.stack([c, zero, s, zero, one, zero, -s, zero, c], axis=1).reshape(-1, 3, 3)

    def second(x: np.ndarray) -> np.ndarray:
        return (-x[4:] + 16 * x[3:-1] - 30 * x[2:-2] + 16 * x[1:-3] - x[:-4]) * fps**2 / 12.0

    force = mass * (second(turn @ centre + hold.position) - DOWN)
    spin = np.zeros((frames - 4, 3))
    spin[:, 1] = mass / 12.0 * (lengths[0] ** 2 + lengths[2] ** 2) * second(angle)
    torque = spin + np.cross((turn @ (centre - hold.box.mean(axis=0)))[2:-2], force)
    assert np.abs(reading[:, 0] - force[4:-4]).max() < 0.01 * np.abs(force).max()
    assert np.abs(reading[:, 1] - torque[4:-4]).max() < 0.01 * np.abs(torque).max()


def effects_of(belief: Belief) -> Belief:
    """A belief with what changes reactions in ways of its own."""
    gravity = {"delta_g_x": 0.3, "delta_g_y": -0.2, "delta_g_z": 0.1}
    belief = belief.with_effect("viscosity", {"eta": 3.0}).with_effect("gravity", gravity)
    return belief.with_effect("hold_compliance", {"compliance": 2e-4})


@pytest.mark.parametrize("effects", [False, True], ids=["plain", "with effects"])
def test_readings_and_their_gradient_follow_differences(effects: bool) -> None:
    frames = 7
    capture = moved_bar(frames)
    predictor = predictor_of(capture, 0.012, dtype="float64")
    belief = bar_belief(capture, youngs_modulus=(6e4, 3e4), density=(900.0, 1200.0), free=FREE)
    belief = effects_of(belief) if effects else belief
    keys = [p.key for p in belief.free]
    substep = predictor.stable_substep(belief)
    found = predictor.predict(belief, keys=keys, substep=substep)
    random = np.random.default_rng(0)
    weights = [random.standard_normal(reading.value.shape) for reading in found.readings]
    marks = 1e2 * random.standard_normal(found.position.shape)
    _, gradient = predict_with_gradient(
        predictor, belief, lambda _: marks, keys=keys, last=frames, substep=substep,
        reading_slopes=lambda _: weights,
    )  # fmt: skip
    for slot in range(len(keys)):
        step = 1e-5 * np.eye(len(keys))[slot]
        ends = [
            predictor.predict(belief.at(belief.coordinates + change), substep=substep)
            for change in (step, -step)
        ]
        total = np.vdot(marks, found.jacobian[..., slot])
        for k, reading in enumerate(found.readings):
            change = (ends[0].readings[k].value - ends[1].readings[k].value) / 2e-5
            tangent = reading.jacobian[..., slot]
            assert np.abs(change).max() > 0.0
            np.testing.assert_allclose(tangent, change, atol=1e-5 * np.abs(change).max(), err_msg=keys[slot])
            total += np.vdot(weights[k], tangent)
        assert gradient[slot] == pytest.approx(total, rel=1e-9), keys[slot]


def test_a_late_clock_shows_readings_later() -> None:
    frames = 30
    predictor = predictor_of(moved_bar(frames, fps=200.0), 0.012, dtype="float64")
    plain = bar_belief(predictor.capture, youngs_modulus=1e5).with_effect("viscosity", {"eta": 150.0})
    substep = predictor.stable_substep(plain)

    def late(offset: float) -> Belief:
        return plain.with_effect("time_offset", {"offset": offset})

    found = predictor.predict(late(1e-3), keys=["time_offset.offset"], substep=substep)
    ends = [predictor.predict(late(1e-3 + step), substep=substep) for step in (2e-4, -2e-4)]
    slope = late(1e-3)["time_offset.offset"].slope
    for reading, ahead, behind in zip(found.readings, *(end.readings for end in ends), strict=True):
        change = (ahead.value - behind.value)[12:-2] / 4e-4 * slope
        apart = reading.jacobian[12:-2, ..., 0] - change
        assert np.sqrt(np.mean(apart**2)) < 0.15 * np.sqrt(np.mean(change**2))


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_a_resting_bar_weighs_on_its_hold_in_mls(dtype: str) -> None:
    frames = 8
    capture = bar_capture(lengths=(LENGTH,), side=SIDE, held=HELD, rest="equilibrium", frames=frames, fps=100)
    capture = with_sensors(capture, force_at(0, frames))
    belief = bar_belief(capture, prestress="equilibrium", youngs_modulus=2e5, density=DENSITY)
    belief = belief.with_effect("viscosity", {"eta": 100.0})
    (force,) = predictor_of(capture, 0.01, transfer=MLS, dtype=dtype).predict(belief).readings
    weight = DENSITY * (LENGTH + HELD) * SIDE**2 * DOWN
    lever = np.array([0.5 * (LENGTH - HELD), 0.01, 0.01]) - capture.sequences[0].held[0].box.mean(axis=0)
    scale = np.linalg.norm(weight)
    # The rest shape is the other transfer's: a little swing is left.
    mean = force.value[1:].mean(axis=0)
    np.testing.assert_allclose(mean[0], -weight, atol=0.03 * scale)
    np.testing.assert_allclose(mean[1], -np.cross(lever, weight), atol=0.05 * scale * np.linalg.norm(lever))


@pytest.mark.parametrize("key", ["part0.youngs_modulus", "part1.density"])
def test_readings_of_mls_follow_differences(key: str) -> None:
    capture = moved_bar(5)
    predictor = predictor_of(capture, 0.015, dtype="float64", transfer=MLS)
    belief = bar_belief(capture, youngs_modulus=(6e4, 3e4), density=(900.0, 1200.0), free=(key,))
    substep = predictor.stable_substep(belief)
    found = predictor.predict(belief, keys=[key], substep=substep)
    ends = [
        predictor.predict(belief.at(belief.coordinates + step), substep=substep).readings
        for step in (1e-5, -1e-5)
    ]
    random, total, weights = np.random.default_rng(0), 0.0, []
    for k, reading in enumerate(found.readings):
        change = (ends[0][k].value - ends[1][k].value) / 2e-5
        assert np.abs(change).max() > 0.0
        np.testing.assert_allclose(reading.jacobian[..., 0], change, atol=1e-4 * np.abs(change).max())
        weights.append(random.standard_normal(reading.value.shape))
        total += np.vdot(weights[-1], reading.jacobian[..., 0])
    _, gradient = predict_with_gradient(
        predictor, belief, np.zeros_like, keys=[key], last=5, substep=substep,
        reading_slopes=lambda _: weights,
    )  # fmt: skip
    assert gradient[0] == pytest.approx(total, rel=1e-7)


def test_both_transfers_tell_the_same_forces() -> None:
    frames, fps = 40, 200.0
    times = np.arange(frames) / fps
    motion = 1e-3 * (ramp(times / 0.15) * np.sin(50.0 * times))[:, None] * [0.2, 0.6, 0.8]
    capture = bar_capture(
        lengths=(LENGTH,), side=SIDE, held=HELD, frames=frames, fps=fps, gravity=np.zeros(3), motion=motion
    )
    capture = with_sensors(capture, force_at(0, frames))
    belief = bar_belief(capture, youngs_modulus=2e6).with_effect("viscosity", {"eta": 200.0})
    one, other = (
        predictor_of(capture, 0.01, transfer=transfer).predict(belief).readings[0].value[1:-1]
        for transfer in (TOTAL_LAGRANGIAN, MLS)
    )
    for v in range(2):
        assert np.sqrt(np.mean((one[:, v] - other[:, v]) ** 2)) < 0.05 * np.sqrt(np.mean(one[:, v] ** 2))


def test_readings_of_a_window_are_those_of_the_whole() -> None:
    capture = moved_bar(9)
    belief = bar_belief(capture, youngs_modulus=6e4)
    predictor = predictor_of(capture, 0.012)
    substep = predictor.stable_substep(belief)
    whole, window = (predictor.predict(belief, last=last, substep=substep) for last in (9, 6))
    assert len(window.position) == 6
    for a, b in zip(window.readings, whole.readings, strict=True):
        np.testing.assert_array_equal(a.value, b.value[:6])


def test_sensors_leave_the_markers_as_they_are_to_the_bit() -> None:
    capture = moved_bar(6)
    bare = replace(capture, sequences=(replace(capture.sequences[0], sensors=()),))
    belief = bar_belief(capture, youngs_modulus=6e4, free=FREE)
    keys = [p.key for p in belief.free]
    one, other = (predictor_of(c, 0.012).predict(belief, keys=keys) for c in (capture, bare))
    np.testing.assert_array_equal(one.position, other.position)
    np.testing.assert_array_equal(one.jacobian, other.jacobian)


@pytest.mark.parametrize("paired", [False, True])
def test_weights_at_a_frame_are_exact_for_parabolas(paired: bool) -> None:
    steps = np.array([8, 2, 12, 30] if paired else [7, 1, 12, 30])
    dt = np.array([2e-4, 1.4e-3, 1e-4, 5e-5])
    weights = reaction_weights({"steps": steps, "dt": dt, "paired": paired})
    begin = np.r_[0, np.cumsum(steps)]
    ends = np.r_[0.0, np.cumsum(steps * dt)]
    # of a pair the first asks in its middle and takes 2 - sqrt 2 of it, the second asks at its end
    within = np.tile([2.0 - 2.0**0.5, 1.0] if paired else [0.5, 0.5], 15)
    middle = np.concatenate([ends[k] + (np.arange(n) + within[:n]) * dt[k] for k, n in enumerate(steps)])
    for frame in range(len(ends)):
        own = np.zeros(len(middle))
        if frame > 0:
            own[begin[frame - 1] : begin[frame]] += weights[begin[frame - 1] : begin[frame], 1]
        if frame < len(steps):
            own[begin[frame] : begin[frame + 1]] += weights[begin[frame] : begin[frame + 1], 0]
        most = 2 if 0 < frame < len(steps) else 1
        for power in range(most + 1):
            assert own @ (middle - ends[frame]) ** power == pytest.approx(float(power == 0), abs=1e-9)


def test_the_cost_and_its_gradient_have_the_sensors_in_them() -> None:
    frames = 8
    capture = moved_bar(frames, fit=(0, frames))
    experiment = Experiment.of(capture, Settings(0.012, workers=1, dtype="float64"))
    problem = replace(experiment.problem(0.012), substep=4e-4)
    belief = bar_belief(capture, youngs_modulus=(6e4, 3e4), free=FREE[:2])
    evaluation = problem.evaluate(belief)
    assert evaluation.sensor_rows["a"] == slice(3 * 4 * frames, evaluation.data_rows)
    assert evaluation.data_rows - 3 * 4 * frames == 9 * (frames - 2)
    cost, gradient = cost_and_gradient(problem, belief)
    assert cost == pytest.approx(evaluation.cost, rel=1e-12)
    np.testing.assert_allclose(gradient, evaluation.jacobian.T @ evaluation.residual, rtol=1e-8)
    bare = replace(capture, sequences=(replace(capture.sequences[0], sensors=()),))
    without = Experiment.of(bare, Settings(0.012, workers=1, dtype="float64")).problem(0.012)
    alone = replace(without, substep=4e-4).evaluate(belief)
    np.testing.assert_array_equal(alone.residual[: 12 * frames], evaluation.residual[: 12 * frames])
    np.testing.assert_array_equal(alone.jacobian[: 12 * frames], evaluation.jacobian[: 12 * frames])
