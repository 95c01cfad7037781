"""What an unsure boundary leaves open of materials."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mphygs.capture.meshes import Part
from mphygs.fit.boundary_share import boundary_columns, found_boundary, marginalised, widened
from mphygs.model.belief import Parameter


def box(name: str, sides: tuple[float, float, float], boundary: float) -> Part:
    mesh = trimesh.creation.box(extents=sides)
    return Part(name, np.array(mesh.vertices), np.array(mesh.faces), boundary)


def unknown(key: str) -> Parameter:
    return Parameter(key, 1e3, "Pa", log=True, lower=1e-3)


def test_a_plate_is_known_by_its_rigidity_and_its_mass() -> None:
    # 0.2 mm to each side of a plate 2 mm thick, whose edges are small
    plate = box("plate", (1.0, 1.0, 0.002), 2e-4)
    free = [unknown(f"plate.{name}") for name in ("youngs_modulus", "density", "poissons_ratio")]
    (column,) = boundary_columns([plate], free).T
    assert column == pytest.approx([3 * np.log(1.2), np.log(1.2), 0.0], rel=0.01)
    # the same mass and the same rigidity E t^3, of the thinner plate that is made of it
    thickness = 0.002 / np.exp(column[1])
    assert np.exp(column[0]) * thickness**3 == pytest.approx(0.002**3)
    assert np.exp(column[1]) * thickness == pytest.approx(0.002)


def test_given_boundaries_and_fixed_materials_leave_nothing_open() -> None:
    given, found = box("given", (1, 1, 1), 0.0), box("found", (1, 1, 1), 0.1)
    free = [unknown("given.youngs_modulus"), unknown("found.density")]
    assert boundary_columns([given, found], free).T == pytest.approx(np.array([[0.0, np.log1p(0.1 * 6)]]))
    assert boundary_columns([given], free).shape == (2, 0)
    assert boundary_columns([found], [unknown("wind.speed")]).shape == (1, 0)
    before = np.eye(2), 2.0 * np.eye(2)
    assert np.array_equal(widened(*before, np.zeros((2, 0))), before)


def test_marginals_are_those_of_all_unknowns_together() -> None:
    rng = np.random.default_rng(5)
    rows, columns = rng.normal(size=(12, 4)), rng.normal(size=(4, 2))
    prior = np.diag([0.5, 0.0, 2.0, 0.1])
    information = rows.T @ rows
    # measurements feel coordinates + columns @ nuisances; nuisances are standard normal
    both = np.concatenate([rows, rows @ columns], axis=1)
    joint = both.T @ both
    joint[4:, 4:] += np.eye(2)
    schur = joint[:4, :4] - joint[:4, 4:] @ np.linalg.solve(joint[4:, 4:], joint[4:, :4])
    assert marginalised(information, columns) == pytest.approx(schur)
    joint[:4, :4] += prior
    alone = np.linalg.inv(information + prior)
    covariance, less = widened(alone, information, columns)
    assert less == pytest.approx(schur)
    # the estimate moves by what the nuisances do to the measurements ...
    moved = alone @ rows.T @ (rows @ columns)
    assert covariance == pytest.approx(alone + moved @ moved.T)
    # ... which is never better than the one that knows of them, and far from it only along them
    more = covariance - np.linalg.inv(joint)[:4, :4]
    assert np.linalg.eigvalsh(more).min() > -1e-12
    without, _ = widened(alone, information, 0.0 * columns)
    assert without == pytest.approx(alone)


def test_a_boundary_that_is_not_known_at_all_leaves_the_rigidity_only() -> None:
    part = box("part", (1.0, 1.0, 0.01), 1e3)
    free = [unknown("part.youngs_modulus"), unknown("part.density")]
    columns = boundary_columns([part], free)
    information = marginalised(np.diag([100.0, 400.0]), 1e3 * columns)
    along = columns[:, 0] / np.linalg.norm(columns)
    across = np.array([along[1], -along[0]])
    assert along @ information @ along == pytest.approx(0.0, abs=1e-6)
    assert across @ information @ across > 50.0


def test_what_is_thinner_than_a_pixel_is_known_worst() -> None:
    known = [found_boundary(0.002, pixel) / pixel for pixel in (4e-3, 7e-4, 6e-4, 1e-4)]
    assert known[0] == 0.5 and known[-1] == 0.15
    assert 0.5 > known[1] > known[2] > 0.15
    assert found_boundary(0.002, 0.0) == 0.0 and found_boundary(0.0, 1e-3) == 5e-4


def test_area_is_that_of_the_surface() -> None:
    part = box("part", (0.1, 0.2, 0.3), 0.0)
    assert part.area == pytest.approx(2 * (0.1 * 0.2 + 0.2 * 0.3 + 0.3 * 0.1))
    assert replace(part, vertices=2 * part.vertices).area == pytest.approx(4 * part.area)
