"""Forces, pressures and tendons that change with time: closed forms, derivatives, both transfers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.capture.actuators import Actuator, Force, Pressure, Tendon
from mphygs.capture.format import Capture
from mphygs.capture.holds import Load
from mphygs.capture.motions import ramp
from mphygs.capture.sensors import Sensor
from mphygs.model.belief import Belief, Parameter
from mphygs.scene.patch import surface_patch
from mphygs.simulate.prediction import Prediction, Predictor, Settings

E, SIDE, LENGTH = 5e4, 0.02, 0.08
AREA, INERTIA = SIDE**2, SIDE**4 / 12.0
FPS, FRAMES = 20.0, 31
SLOW = ramp(np.arange(FRAMES) / (FRAMES - 8))
MIDDLE = SIDE / 2
TIP = np.array([[LENGTH - 0.01, -1.0, -1.0], [1.0, 1.0, 1.0]])
BOTH = pytest.mark.parametrize("transfer", ["total-lagrangian", "mls"])


def bar(*actuators: Actuator, at: np.ndarray, **changes: object) -> Capture:
    """A bar along x without weight, held before x = 0, that these act on. at: (M, 3) markers [m]."""
    given = {"lengths": (LENGTH,), "gravity": np.zeros(3), "frames": FRAMES, "fps": FPS} | changes
    capture = bar_capture(markers_at=np.asarray(at, float), **given)
    (sequence,) = capture.sequences
    return replace(capture, sequences=(replace(sequence, actuators=actuators),))


def run(capture: Capture, belief: Belief, spacing: float = 0.01, **settings: object) -> Prediction:
    return Predictor(capture, capture.sequence("a"), Settings(spacing, dtype="float64", **settings)).predict(
        belief
    )


def calm(belief: Belief) -> Belief:
    """With damping of the mass, under which slow loads are followed as in statics."""
    return belief.with_effect("mass_damping", {"alpha": 40.0})


def ends(capture: Capture, *, spacing: float = 0.01, nu: float = 0.0, **settings: object) -> np.ndarray:
    """(M, 3) how far the markers went in the end [m]."""
    belief = calm(bar_belief(capture, youngs_modulus=E, poissons_ratio=nu))
    position = run(capture, belief, spacing, **settings).position
    return position[-1] - position[0]


AXIS = [[x, MIDDLE, MIDDLE] for x in (0.03, 0.06)]


@BOTH
def test_a_slow_force_stretches_a_bar_by_f_l_over_e_a(transfer: str) -> None:
    force = 0.2
    values = SLOW[:, None] * [force, 0.0, 0.0]
    moved = ends(bar(Force(values, "pull", box=TIP), at=AXIS), transfer=transfer)
    # Between two places: MLS-MPM's clamp lies a share of a cell behind its face. 1 %: the strain.
    assert moved[1, 0] - moved[0, 0] == pytest.approx(force * 0.03 / (E * AREA), rel=0.02)
    assert np.abs(moved[:, 1:]).max() < 0.02 * moved[1, 0]


@BOTH
def test_a_pressure_on_all_sides_changes_the_volume_by_p_over_k(transfer: str) -> None:
    nu, pressure = 0.3, 250.0
    at = [[x, y, z] for x in (0.02, 0.06) for y in (0.005, 0.015) for z in (0.005, 0.015)]
    moved = ends(
        bar(Pressure(pressure * SLOW, "air"), at=at, held=None), spacing=0.005, nu=nu, transfer=transfer
    )
    strain = [np.polyfit(np.array(at)[:, c], moved[:, c], 1)[0] for c in range(3)]
    bulk = E / (3.0 * (1.0 - 2.0 * nu))
    # The mean over the whole body is exact in both; in MLS-MPM its skin has less of it, the inside more.
    assert sum(strain) == pytest.approx(
        -pressure / bulk, rel=0.03 if transfer == "total-lagrangian" else 0.08
    )
    assert strain == pytest.approx([-pressure / bulk / 3.0] * 3, rel=0.15)
    # No resultant: the body does not drift.
    assert np.abs(moved.mean(0)).max() < 1e-3 * pressure / E * LENGTH


def test_a_pressure_on_both_ends_compresses_by_p_l_over_e() -> None:
    pressure = 500.0
    capture = bar(
        Pressure(pressure * SLOW, "left", box=np.array([[-0.001, -1, -1], [0.001, 1, 1]])),
        Pressure(pressure * SLOW, "right", box=np.array([[LENGTH - 0.001, -1, -1], [LENGTH + 0.001, 1, 1]])),
        at=[[0.02, MIDDLE, MIDDLE], [0.06, MIDDLE, MIDDLE]],
        held=None,
    )
    moved = ends(capture)
    assert moved[1, 0] - moved[0, 0] == pytest.approx(-pressure / E * 0.04, rel=0.03)
    assert np.abs(moved[:, 0].sum()) < 1e-6


def test_a_pressure_on_one_side_bends_like_a_distributed_load() -> None:
    """q L^4 / (8 E I) at the end, q the pressure times the width."""
    pressure = 3.0
    box = np.array([[0.0, -1.0, SIDE - 1e-5], [1.0, 1.0, SIDE + 1e-5]])
    at = [[LENGTH, MIDDLE, MIDDLE]]
    moved = ends(bar(Pressure(pressure * SLOW, "side", box=box), at=at), spacing=0.005)
    expected = -pressure * SIDE * LENGTH**4 / (8.0 * E * INERTIA)
    # Shear adds q L^2 / (2 k G A), k = 5/6.
    expected -= pressure * SIDE * LENGTH**2 / (2.0 * 5.0 / 6.0 * E / 2.0 * AREA)
    assert moved[0, 2] == pytest.approx(expected, rel=0.04)


@BOTH
def test_a_straight_tendon_compresses_by_t_l_over_e_a(transfer: str) -> None:
    tension = 0.2
    path = np.array([[x, MIDDLE, MIDDLE] for x in (-0.003, 0.02, 0.04, 0.07)])
    moved = ends(bar(Tendon(tension * SLOW, "t", path=path), at=AXIS), transfer=transfer)
    assert moved[1, 0] - moved[0, 0] == pytest.approx(-tension * 0.03 / (E * AREA), rel=0.04)
    assert np.abs(moved[:, 1:]).max() < 0.02 * abs(moved[1, 0])


@BOTH
def test_an_eccentric_tendon_bends_by_m_l_squared_over_2_e_i(transfer: str) -> None:
    tension, beside = 0.02, 0.006
    path = np.array([[x, MIDDLE, MIDDLE + beside] for x in (-0.003, *np.linspace(0.005, 0.075, 15))])
    moved = ends(bar(Tendon(tension * SLOW, "t", path=path), at=AXIS), spacing=0.005, transfer=transfer)
    expected = tension * beside * np.array([0.03, 0.06]) ** 2 / (2.0 * E * INERTIA)
    # MLS-MPM's clamp gives way by a share of a cell.
    assert moved[:, 2] == pytest.approx(expected, rel=0.05 if transfer == "total-lagrangian" else 0.12)
    assert np.abs(moved[:, 1]).max() < 0.02 * expected[1]


def test_a_tendon_that_leaves_the_body_pulls_towards_its_anchor_wherever_the_body_goes() -> None:
    tension = 0.2
    values = tension * SLOW
    inside = np.array([[0.07, MIDDLE, MIDDLE]])
    straight = ends(bar(Tendon(values, "t", path=inside, anchor=np.array([0.5, MIDDLE, MIDDLE])), at=AXIS))
    assert straight[:, 0] == pytest.approx(tension * np.array([0.03, 0.06]) / (E * AREA), rel=0.04)
    # An anchor beside the bar's end: what is pulled comes to rest on the line to it, however strong the pull.
    anchor = np.array([0.05, MIDDLE, MIDDLE + 0.06])
    at = [[0.07, MIDDLE, MIDDLE]]
    aside = ends(bar(Tendon(values / 2.0, "t", path=inside, anchor=anchor), at=at))
    toward = anchor - np.array(at[0]) - aside[0]
    fixed = ends(bar(Force(np.outer(values / 2.0, toward / np.linalg.norm(toward)), "f", box=TIP), at=at))
    assert np.linalg.norm(aside - fixed) < 0.15 * np.linalg.norm(aside) and np.linalg.norm(aside) > 0.005


@BOTH
def test_a_force_in_a_file_that_is_constant_is_the_constant_load(transfer: str) -> None:
    pull = np.array([0.02, 0.01, -0.03])
    at = [[LENGTH, SIDE, SIDE]]
    values = np.tile(pull, (FRAMES, 1))
    given = bar(Force(values, "f", 2, 9, box=TIP), at=at)
    constant = bar(at=at, loads=(Load(TIP, pull, 2, 9),))
    belief = bar_belief(given, youngs_modulus=E)
    one, other = (run(c, belief, transfer=transfer).position for c in (given, constant))
    np.testing.assert_allclose(one, other, atol=1e-10)
    assert np.abs(one - one[0]).max() > 1e-3
    # Without loads of a file nothing is touched, to the bit.
    plain = replace(constant, sequences=(replace(constant.sequences[0], loads=()),))
    idle = replace(plain, sequences=(replace(plain.sequences[0], actuators=()),))
    assert np.array_equal(
        run(plain, belief, transfer=transfer).position, run(idle, belief, transfer=transfer).position
    )


def test_between_frames_a_force_is_smooth() -> None:
    """A free body under 1 - cos(w t): its motion is the integral of that, and not of steps at the frames."""
    omega, fps, frames = 2 * np.pi * 4.0, 40.0, 30
    times = np.arange(frames) / fps
    values = (1.0 - np.cos(omega * times))[:, None] * [0.0, 0.1, 0.0]
    capture = bar(
        Force(values, "f", box=np.array([[-1.0] * 3, [1.0] * 3])), at=[[0.04, MIDDLE, MIDDLE]],
        held=None, frames=frames, fps=fps,
    )  # fmt: skip
    position = run(capture, bar_belief(capture)).position
    mass = 1000.0 * AREA * LENGTH
    moved = 0.1 / mass * (times**2 / 2 - (1 - np.cos(omega * times)) / omega**2)
    velocity = 0.1 / mass * (times - np.sin(omega * times) / omega)
    # About its mean speed it swings by 0.1 / (m w); substeps and ends of the spline leave 1 % of that.
    found = np.diff(position[:, 0, 1]) * fps - np.diff(moved) * fps
    assert np.abs(found).max() < 0.01 * 0.1 / mass / omega
    assert velocity.max() > 1.0


def driven() -> tuple[Capture, Belief]:
    """A bar under all kinds at once, their gains and delays free besides the stiffness."""
    times = np.arange(12) / 50.0
    wave = 0.5 - 0.5 * np.cos(2 * np.pi * 4.0 * times)
    path = np.array(
        [[-0.003, MIDDLE, 0.015], [0.02, MIDDLE, 0.016], [0.05, MIDDLE, 0.014], [0.07, 0.008, 0.016]]
    )
    top = np.array([[0.02, -1.0, 0.0199], [0.06, 1.0, 0.0201]])
    actuators = (
        Tendon(0.3 * wave, "t", 0, 9, ("gain", "delay"), path=path, anchor=np.array([0.12, 0.0, 0.05])),
        Pressure(200.0 * wave[::-1], "p", 1, None, ("gain", "delay"), box=top),
        Force(wave[:, None] * [0.01, 0.02, 0.03], "f", 0, None, ("delay",), box=TIP),
    )
    at = [[LENGTH, SIDE, SIDE], [0.04, 0.0, MIDDLE]]
    capture = bar(*actuators, at=at, frames=12, fps=50.0, motion=np.outer(times, [0.0, 0.02, 0.05]))
    belief = bar_belief(capture, youngs_modulus=E, free=["part0.youngs_modulus", "part0.density"])
    numbers = [Parameter(f"{name}.gain", 0.8, "-", 0.01, 100.0, log=True) for name in ("t", "p")] + [
        Parameter(f"{name}.delay", 0.007, "s", -0.5, 0.5, scale=0.02) for name in ("t", "p", "f")
    ]
    return capture, replace(belief, parameters=(*belief.parameters, *numbers))


@BOTH
def test_derivatives_by_gain_delay_and_material_follow_differences(transfer: str) -> None:
    capture, belief = driven()
    settings = Settings(0.01, dtype="float64", transfer=transfer)
    predictor = Predictor(capture, capture.sequence("a"), settings)
    substep = predictor.stable_substep(belief)
    keys = [p.key for p in belief.free]
    found = predictor.predict(belief, keys=keys, substep=substep)
    for slot, key in enumerate(keys):
        step = 1e-4

        def at(by: float, key: str = key) -> np.ndarray:
            moved = replace(
                belief,
                parameters=tuple(p.at(p.coordinate + by) if p.key == key else p for p in belief.parameters),
            )
            return predictor.predict(moved, substep=substep).position

        slope = (8 * (at(step) - at(-step)) - (at(2 * step) - at(-2 * step))) / (12 * step)
        size = np.abs(slope).max()
        assert size > 1e-7, key
        assert np.abs(found.jacobian[..., slot] - slope).max() < 1e-4 * size, key


def test_a_gain_scales_and_a_delay_shifts() -> None:
    capture, belief = driven()
    (sequence,) = capture.sequences
    tendon = sequence.actuators[0]
    late = tendon.course(np.arange(12) / 50.0 - 0.02, 50.0)
    stated = replace(capture, sequences=(replace(sequence, actuators=(replace(tendon, end_frame=None),)),))
    true = replace(tendon, values=0.5 * late, end_frame=None)
    belief = belief.with_parameter("t.gain", value=0.5).with_parameter("t.delay", value=0.02)
    plain = belief.with_parameter("t.gain", value=1.0).with_parameter("t.delay", value=0.0)
    actual = replace(capture, sequences=(replace(sequence, actuators=(true,)),))
    one, other = run(stated, belief).position, run(actual, plain).position
    np.testing.assert_allclose(one, other, atol=2e-2 * np.abs(other - other[0]).max())
    assert np.abs(one - run(stated, plain).position).max() > 0.1 * np.abs(other - other[0]).max()


def test_a_patch_has_the_area_and_the_outside_of_what_it_covers() -> None:
    capture = bar_capture(lengths=(0.03, 0.05), held=0.006, side=SIDE)
    boxes = np.array([h.box for h in capture.sequence("a").held])

    def vectors(**given: object) -> tuple[float, np.ndarray]:
        patch = surface_patch(capture.parts, max_edge=0.007, **given)
        a, b, c = (patch.vertices[patch.triangles[:, k]] for k in range(3))
        area = 0.5 * np.cross(b - a, c - a)
        return float(np.linalg.norm(area, axis=1).sum()), area.sum(0)

    whole, sum_ = vectors()
    # The interface between the parts is no surface of the object; lengths are where parts end.
    assert whole == pytest.approx(4 * SIDE * (0.08 + 0.006) + 2 * AREA, rel=1e-9)
    assert np.abs(sum_).max() < 1e-15
    held, sum_ = vectors(exclude_boxes=boxes)
    assert held == pytest.approx(whole - 4 * SIDE * 0.006 - AREA, rel=1e-9)
    assert sum_ == pytest.approx([AREA, 0.0, 0.0], abs=1e-15)
    # A box a tenth of a millimetre thick about the upper side has two strips of the walls beside it as well.
    top, sum_ = vectors(box=np.array([[0.011, -1.0, SIDE - 1e-4], [0.04, 1.0, SIDE + 1e-4]]))
    assert top == pytest.approx(0.029 * (SIDE + 2e-4), rel=1e-6)
    assert sum_ == pytest.approx([0.0, 0.0, 0.029 * SIDE], rel=1e-6, abs=1e-12)
    one, _ = vectors(part="part1")
    two, _ = vectors(part="part0")
    assert one + two == pytest.approx(whole, rel=1e-12)


def test_a_patch_that_is_all_held_is_refused() -> None:
    box = np.array([[-0.01, -1.0, -1.0], [-0.001, 1.0, 1.0]])
    capture = bar(Pressure(SLOW, "air", box=box), at=AXIS)
    with pytest.raises(ValueError, match="sequence 'a', load 'air': its patch has no surface that is open"):
        run(capture, bar_belief(capture))


def test_no_force_is_read_where_a_tendon_ends_in_the_hold() -> None:
    values = np.full(FRAMES, 0.1)
    path = np.array([[-0.005, MIDDLE, MIDDLE], [0.06, MIDDLE, MIDDLE]])
    capture = bar(Tendon(values, "pull", path=path), at=AXIS)
    (sequence,) = capture.sequences
    sensor = Sensor("force", np.zeros((FRAMES, 1, 3)), sigma=np.array([1e-3]), hold=0)
    capture = replace(capture, sequences=(replace(sequence, sensors=(sensor,)),))
    with pytest.raises(ValueError, match=r"sensors\[0\]: a tendon passes hold 0"):
        Predictor(capture, capture.sequence("a"), Settings(0.01, dtype="float64"))
