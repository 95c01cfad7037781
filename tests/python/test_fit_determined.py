"""What is said of parameters that the grid bends, and of those that are a direction together."""

from __future__ import annotations

import numpy as np
import pytest

from mphygs.fit.determined import determinations, of_unit_length
from mphygs.model.belief import Parameter

AXES = ("n_x", "n_y", "n_z")


def walls(vector: tuple[float, float, float], scale: float = 0.1) -> list[Parameter]:
    """A place, and a normal as long as it happens to be, with the prior that keeps its length."""
    place = Parameter("contact.d", 0.2, "m", log=False, scale=0.01, free=True)
    normal = [
        Parameter(f"contact.{a}", v, "-", log=False, scale=scale, free=True, prior_mean=v, prior_std=0.5)
        for a, v in zip(AXES, vector, strict=True)
    ]
    return [place, *normal]


def test_a_normal_is_as_sure_as_its_direction() -> None:
    vector = np.array([0.0, 1.2, 0.9])
    free = walls(tuple(vector))
    unit, length = vector / 1.5, 1.5
    # measured: the angles about two axes across to 0.01 and 0.02, the place to 1 mm, and no length
    first, second = np.array([1.0, 0.0, 0.0]), np.cross(unit, [1.0, 0.0, 0.0])
    rows = np.zeros((3, 4))
    rows[0, 1:], rows[1, 1:] = 0.1 * first / length / 0.01, 0.1 * second / length / 0.02
    rows[2, 0] = 0.01 / 1e-3
    information = rows.T @ rows
    prior = np.diag([0.0, *[1.0 / 5.0**2] * 3])
    covariance = np.linalg.inv(information + prior)
    plain = determinations(free, information, covariance)
    assert not plain["contact.n_y"].determined and plain["contact.n_y"].std > 0.3
    told, more, less = of_unit_length(free, information, covariance)
    assert [p.value for p in told] == pytest.approx([0.2, *unit])
    assert first @ more[1:, 1:] @ first == pytest.approx((0.1 / 0.01) ** 2)
    known = determinations(told, more, less)
    assert all(item.determined for item in known.values())
    wanted = [1e-3, 0.01, 0.02 * abs(second[1]), 0.02 * abs(second[2])]
    assert [known[p.key].std for p in told] == pytest.approx(wanted, rel=2e-3)
    # what was given is left alone
    assert [p.value for p in free] == [0.2, *vector]
    assert information[1:, 1:] == pytest.approx((rows.T @ rows)[1:, 1:])


def test_a_direction_that_nothing_tells_stays_undetermined() -> None:
    free = walls((0.0, 0.0, 1.0))
    information = np.diag([100.0, 0.0, 0.0, 0.0])
    covariance = np.linalg.inv(information + np.diag([0.0, *[1.0 / 25.0] * 3]))
    known = determinations(*of_unit_length(free, information, covariance))
    assert not known["contact.n_x"].determined and known["contact.n_x"].std == pytest.approx(0.5)
    assert known["contact.d"].determined


def test_what_the_grid_leaves_as_open_as_the_prior_is_not_determined() -> None:
    softer, stiffer = (
        Parameter(f"{part}.youngs_modulus", value, "Pa", 1e2, 1e9, log=True, prior_mean=11.5, prior_std=2.5)
        for part, value in (("lower", 131e3), ("upper", 74e3))
    )
    information = np.diag([1.0 / 0.05**2, 1.0 / 0.1**2])  # of the logarithms: 5 and 10 %
    noise = np.linalg.inv(information + np.eye(2) / 2.5**2)
    assert all(found.determined for found in determinations([softer, stiffer], information, noise).values())
    bent = noise + np.diag([0.9**2, 2.2**2])  # half of the prior's is 1.25
    known = determinations([softer, stiffer], information, bent)
    assert known[softer.key].determined and known[softer.key].note == ""
    assert not known[stiffer.key].determined and "grid" in known[stiffer.key].note
    assert known[stiffer.key].std == pytest.approx(74e3 * 2.2, rel=2e-3)


def test_a_narrow_prior_that_hardly_shows_is_no_matter_of_the_grid() -> None:
    length = Parameter("hold.length", 1.0, "m", log=False, prior_mean=1.0, prior_std=0.02)
    information = np.array([[1e6]])
    assert determinations([length], information, np.array([[0.015**2]]))[length.key].determined


def test_other_numbers_are_left_as_they_are() -> None:
    free = walls((0.0, 0.0, 2.0))[:3]  # no third component
    matrix = np.eye(3)
    told, information, covariance = of_unit_length(free, matrix, matrix)
    assert told == free
    assert np.array_equal(information, matrix) and np.array_equal(covariance, matrix)
