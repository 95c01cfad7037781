"""Inside tests and box overlap against shapes whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mphygs.capture.overlap import (
    box_meets_solid,
    distance_to_box,
    just_inside,
    triangles_in_box,
    winding_number,
)


def test_winding_number_tells_inside_from_outside() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (500, 3))
    radius = np.linalg.norm(points, axis=1)
    points = points[(radius < 0.93) | (radius > 1.0)]
    winding = winding_number(points, ball.vertices, ball.faces)
    assert np.allclose(winding, np.linalg.norm(points, axis=1) < 0.95, atol=1e-9)
    assert np.allclose(winding_number(points, ball.vertices, ball.faces[:, ::-1]), -winding)


def test_winding_number_is_the_same_in_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    ball = trimesh.creation.icosphere(subdivisions=1)
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    whole = winding_number(points, ball.vertices, ball.faces)
    monkeypatch.setattr("mphygs.capture.overlap._CHUNK", 7 * len(ball.faces))
    assert np.array_equal(winding_number(points, ball.vertices, ball.faces), whole)


def test_triangles_in_box_agrees_with_dense_samples() -> None:
    random = np.random.default_rng(1)
    triangles = random.uniform(-2, 2, (400, 3, 3))
    box = np.array([[-0.6, -0.5, -0.4], [0.5, 0.7, 0.6]])
    u, v = np.meshgrid(np.linspace(0, 1, 101), np.linspace(0, 1, 101))
    weight = np.stack([u, v, 1 - u - v], axis=-1)[u + v <= 1]
    samples = np.einsum("sk,fkd->fsd", weight, triangles)
    sampled = ((samples >= box[0]) & (samples <= box[1])).all(axis=2).any(axis=1)
    exact = triangles_in_box(triangles, box)
    assert 50 < sampled.sum() < 350
    assert exact[sampled].all()
    # those the samples miss graze the box
    grown = np.array([box[0] - 0.05, box[1] + 0.05])
    near = ((samples >= grown[0]) & (samples <= grown[1])).all(axis=2).any(axis=1)
    assert near[exact].all()


def test_box_meets_solid_inside_across_and_outside() -> None:
    cube = trimesh.creation.box(extents=(2, 2, 2))
    arguments = (np.array(cube.vertices), np.array(cube.faces))
    assert box_meets_solid(np.array([[-0.1] * 3, [0.1] * 3]), *arguments)
    assert box_meets_solid(np.array([[0.9, -0.1, -0.1], [1.1, 0.1, 0.1]]), *arguments)
    assert box_meets_solid(np.array([[-9.0] * 3, [9.0] * 3]), *arguments)
    assert not box_meets_solid(np.array([[1.1, 1.1, 1.1], [2, 2, 2]]), *arguments)
    ring = trimesh.creation.torus(major_radius=2.0, minor_radius=0.3)
    hole = np.array([[-0.2] * 3, [0.2] * 3])
    assert not box_meets_solid(hole, np.array(ring.vertices), np.array(ring.faces))


def test_distance_to_box() -> None:
    box = np.array([[0.0, 0, 0], [1, 1, 1]])
    points = np.array([[0.5, 0.5, 0.5], [2, 0.5, 0.5], [-3, -4, 0.5]])
    assert np.allclose(distance_to_box(points, box), [0, 1, 5])


@pytest.mark.parametrize("kind", ["ball", "box", "ring"])
def test_winding_number_of_many_triangles_is_that_of_all(monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    mesh = {
        "ball": lambda: trimesh.creation.icosphere(subdivisions=5),
        "box": lambda: trimesh.creation.box().subdivide_to_size(0.03),
        "ring": lambda: trimesh.creation.torus(1.0, 0.1, major_sections=160, minor_sections=40),
    }[kind]()
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
    points = np.random.default_rng(0).uniform(-1.2, 1.2, (50, 3))
    points = np.concatenate([points, just_inside(vertices, faces)])
    quick = winding_number(points, vertices, faces)
    monkeypatch.setattr("mphygs.capture.overlap._MANY", len(faces))
    assert np.abs(winding_number(points, vertices, faces) - quick).max() < 0.03
    assert len(faces) > 10_000 and (quick[50:] > 0.5).all() and (np.abs(quick - np.round(quick)) < 0.03).all()
