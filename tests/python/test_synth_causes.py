"""Causes outside the list of effects: their formulas, and what they do in a run."""

import numpy as np
import pytest

from mphygs.synth.causes import CAUSES, MaterialState
from synth_example import SIGMA, made, tracks


def material(count: int = 6, seed: int = 0, **changes: object) -> MaterialState:
    generator = np.random.default_rng(seed)
    values = {
        "reference": generator.standard_normal((count, 3)),
        "position": generator.standard_normal((count, 3)),
        "velocity": generator.standard_normal((count, 3)),
        "deformation": np.eye(3) + 0.1 * generator.standard_normal((count, 3, 3)),
        "mass": generator.uniform(1.0, 2.0, count),
        "volume": generator.uniform(1.0, 2.0, count),
        "inside": np.arange(count) % 2 == 0,
        "time": 0.3,
    }
    return MaterialState(**(values | changes))


def test_cubic_drag_is_minus_c_speed_cubed() -> None:
    m = material()
    force, stress = CAUSES["cubic_drag"].function(m, {"c_3": 2.0})
    speed = np.linalg.norm(m.velocity, axis=1)
    along = np.einsum("qi,qi->q", force, m.velocity) / speed
    assert along == pytest.approx(-2.0 * m.mass * speed**3 * m.inside)
    assert stress is None


def test_point_field_falls_with_the_square_of_the_distance() -> None:
    values = {"strength": 3.0, "x": 0.0, "y": 0.0, "z": 0.0, "core": 0.0}
    position = np.array([[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, -4.0, 0.0]])
    m = material(3, position=position, mass=np.ones(3), inside=np.ones(3, bool))
    force, _ = CAUSES["point_field"].function(m, values)
    assert force == pytest.approx(3.0 * np.array([[-1.0, 0, 0], [-0.25, 0, 0], [0, 1 / 16, 0]]))
    at_point = material(1, position=np.zeros((1, 3)), inside=np.ones(1, bool))
    force, _ = CAUSES["point_field"].function(at_point, values | {"core": 0.01})
    assert np.isfinite(force).all()


def test_actuation_is_an_internal_stress_along_its_fibre() -> None:
    values = {
        "amplitude": 5.0,
        "f": 2.0,
        "a_x": 1.0,
        "a_y": 0.0,
        "a_z": 0.0,
        "b_x": 0.0,
        "b_y": 1.0,
        "b_z": 0.0,
    }
    m = material()
    force, stress = CAUSES["actuation"].function(m, values)
    assert force is None
    # Kirchhoff stress P F^T is symmetric: no moment from nowhere.
    kirchhoff = np.einsum("qij,qkj->qik", stress, m.deformation)
    assert kirchhoff == pytest.approx(np.swapaxes(kirchhoff, 1, 2))
    assert not stress[~m.inside].any() and stress[m.inside].any()
    quarter = CAUSES["actuation"].function(material(time=0.5), values)[1]
    assert np.abs(quarter).max() < 1e-12
    second_kind = np.einsum("qij,qjk->qik", np.linalg.inv(m.deformation), stress)[m.inside]
    assert np.abs(second_kind[:, 0, 0]).max() == pytest.approx(5.0 * abs(np.sin(2.0 * np.pi * 2.0 * 0.3)))


def test_a_cause_acts_on_its_part_alone_and_grows_with_its_strength(tmp_path) -> None:
    def moved(name: str, hidden: tuple[str, ...]) -> np.ndarray:
        return tracks(made(tmp_path / name, "two-part-bar", hidden, noise_free=True)[1])

    plain = moved("plain", ())
    once = moved("once", ("cubic_drag:c_3=4",)) - plain
    twice = moved("twice", ("cubic_drag:c_3=8",)) - plain
    other = moved("other", ("cubic_drag:c_3=4:part=lower",)) - plain
    assert np.abs(once).max() > 0.1 * SIGMA
    assert np.abs(twice).max() == pytest.approx(2.0 * np.abs(once).max(), rel=0.2)
    # The lower part moves far less, and with it what slows it down.
    assert np.abs(other).max() < 0.2 * np.abs(once).max()
