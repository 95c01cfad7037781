"""Readings of constructed force fields."""

import numpy as np
import pytest

from mphygs.diagnose.force_readings import (
    ForceSample,
    force_place,
    force_time,
    is_internal,
    mean_direction,
    nature,
    power_share,
    rms,
    share_of_place_alone,
    share_of_time_alone,
)

TIMES = np.linspace(0.0, 2.0, 61)


def sample(force: np.ndarray, velocity: np.ndarray | None = None, name: str = "a") -> ForceSample:
    """Six cells on a line along x, the last two of another part and twice as heavy."""
    position = np.zeros((61, 6, 3))
    position[..., 0] = np.arange(6.0)
    if velocity is None:
        velocity = np.random.default_rng(0).standard_normal((61, 6, 3))
    mass = np.array([1.0, 1, 1, 1, 2, 2])
    part = np.array([0, 0, 0, 0, 1, 1])
    full = np.broadcast_to(force, (61, 6, 3)).astype(float)
    return ForceSample(name, full, position, velocity, mass, part, ("stem", "head"), np.arange(1, 62))


def wave(frequency: float = 1.5) -> np.ndarray:
    return np.sin(2 * np.pi * frequency * TIMES)[:, None, None]


def test_size_and_direction() -> None:
    steady = [sample(np.array([3.0, 0.0, 4.0]))]
    assert rms(steady) == pytest.approx(5.0)
    np.testing.assert_allclose(mean_direction(steady), [0.6, 0.0, 0.8])
    there_and_back = [sample(wave() * [0.0, -2.0, 0.0])]
    np.testing.assert_allclose(mean_direction(there_and_back), [0.0, 1.0, 0.0], atol=1e-12)
    assert rms([sample(np.zeros(3))]) == 0.0
    assert np.linalg.norm(mean_direction([sample(np.zeros(3))])) == pytest.approx(1.0)


def test_where_names_the_part_and_the_place() -> None:
    force = np.zeros((61, 6, 3))
    force[:, 5] = [0.0, 2.0, 0.0]
    first, second = force_place([sample(force)])
    assert (first["part"], second["part"]) == ("head", "stem")
    assert first["center"] == [5.0, 0.0, 0.0]
    assert first["share"] == pytest.approx(1.0) and second["rms"] == 0.0
    assert first["rms"] == pytest.approx(np.sqrt(2.0)), "over the whole part"


def test_when_is_the_shortest_stretch_with_half_of_it() -> None:
    force = np.zeros((61, 6, 3))
    force[20:30] = [1.0, 0.0, 0.0]
    force[40] = [0.5, 0.0, 0.0]
    found = force_time([sample(force), sample(0.1 * force, name="b")])
    assert [f["sequence"] for f in found] == ["a", "b"]
    a, b = found[0]["frames"]
    assert 21 <= a < b <= 31 and b - a == 6
    assert found[0]["rms"] == pytest.approx(1.0) and found[1]["rms"] == pytest.approx(0.1)


def test_internal_means_no_sum_and_no_moment() -> None:
    apart = np.zeros((61, 6, 3))
    apart[:, 0], apart[:, 3] = [-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]
    assert is_internal([sample(apart)])
    couple = np.zeros((61, 6, 3))
    couple[:, 0], couple[:, 3] = [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]
    assert not is_internal([sample(couple)]), "a moment is from outside"
    assert not is_internal([sample(np.array([0.0, 0.0, 1.0]))])
    assert not is_internal([sample(np.zeros(3))])


def test_power_against_the_velocity_dissipates() -> None:
    velocity = wave() * np.random.default_rng(1).standard_normal((1, 6, 3))
    drag = -3.0 * np.linalg.norm(velocity, axis=2, keepdims=True) * velocity
    power, one_way = power_share([sample(drag, velocity)])
    assert power < -0.8 and one_way == pytest.approx(1.0)
    assert nature([sample(drag, velocity)]) == ["dissipative"]
    assert nature([sample(-drag, velocity)]) == ["driving"]
    spring = np.gradient(velocity, axis=0)
    assert "dissipative" not in nature([sample(spring, velocity)])
    assert power_share([sample(np.zeros(3))]) == (0.0, 0.0)


def test_time_alone_is_the_frame_and_place_alone_a_field() -> None:
    shaken = sample(wave() * [1.0, 2.0, 0.0])
    assert share_of_time_alone([shaken]) == pytest.approx(1.0)
    assert share_of_place_alone([shaken]) < 0.1
    assert nature([shaken]) == ["frame"]
    places = np.random.default_rng(2).standard_normal((1, 6, 3))
    field = sample(places)
    assert share_of_place_alone([field]) == pytest.approx(1.0)
    assert share_of_time_alone([field]) < 0.8
    assert nature([field]) == ["field"]
    assert set(nature([sample(np.array([0.0, 1.0, 0.0]))])) == {"frame", "field"}
