"""Closest points of meshes against brute force and closed form."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mphygs.scene.closest import closest_on_mesh
from mphygs.scene.particles import closest_material
from test_scene_particles import box, practice, turned


def test_outside_a_box_the_anchor_is_the_clamped_point() -> None:
    low, high = np.array([0.0, 0.0, 0.0]), np.array([0.02, 0.03, 0.01])
    points = np.random.default_rng(1).uniform(-0.02, 0.05, size=(3000, 3))
    part, anchor, offset = closest_material([box(low.tolist(), high.tolist())], points)
    np.testing.assert_allclose(anchor, np.clip(points, low, high), atol=1e-15)
    np.testing.assert_allclose(offset, points - np.clip(points, low, high), atol=1e-15)
    assert np.all(part == 0)
    within = np.all((points > low) & (points < high), axis=1)
    assert within.any()
    assert np.array_equal(anchor[within], points[within])


def test_same_as_a_search_through_every_triangle() -> None:
    mesh = turned(trimesh.creation.torus(0.02, 0.006, 24, 12))
    points = np.random.default_rng(2).uniform(-0.03, 0.05, size=(300, 3))
    found, distance = closest_on_mesh(np.array(mesh.vertices), np.array(mesh.faces), points)
    every = np.stack(
        [
            trimesh.triangles.closest_point(mesh.triangles, np.repeat(point[None], len(mesh.faces), axis=0))
            for point in points
        ]
    )
    lengths = np.linalg.norm(every - points[:, None], axis=2)
    np.testing.assert_allclose(distance, lengths.min(axis=1), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(points - found, axis=1), distance, atol=1e-15)


def test_one_large_triangle_among_small_ones_is_not_missed() -> None:
    # The centre of the large triangle is far from the point just above its corner.
    small = np.array([[0.0, 0.0, 0.5], [0.01, 0.0, 0.5], [0.0, 0.01, 0.5]])
    many = np.concatenate([small + [0.02 * k, 0.0, 0.0] for k in range(20)])
    vertices = np.concatenate([many, [[0.0, 0.0, 0.0], [30.0, 0.0, 0.0], [0.0, 30.0, 0.0]]])
    faces = np.arange(len(vertices)).reshape(-1, 3)
    found, distance = closest_on_mesh(vertices, faces, np.array([[0.1, 0.1, 0.1]]))
    np.testing.assert_allclose(found, [[0.1, 0.1, 0.0]], atol=1e-15)
    assert distance[0] == pytest.approx(0.1)


def test_the_nearest_part_counts_and_the_first_of_equals() -> None:
    left, right = box([0.0, 0.0, 0.0], [0.01, 0.01, 0.01]), box([0.01, 0.0, 0.0], [0.02, 0.01, 0.01])
    points = np.array([[5.0, 5.0, 13.0], [15.0, 5.0, 13.0], [10.0, 5.0, 12.0], [19.0, 5.0, 5.0]]) * 1e-3
    part, anchor, offset = closest_material([left, right], points)
    assert part.tolist() == [0, 1, 0, 1]
    np.testing.assert_allclose(offset[:, 2], [0.003, 0.003, 0.002, 0.0], atol=1e-15)
    np.testing.assert_allclose(anchor + offset, points, atol=1e-18)


def test_degenerate_triangles_do_no_harm() -> None:
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.5, 0.0, 0.0], [2.0, 2.0, 2.0]])
    faces = np.array([[0, 1, 2], [3, 3, 3]])
    found, distance = closest_on_mesh(vertices, faces, np.array([[0.25, 1.0, 0.0], [2.0, 2.0, 3.0]]))
    np.testing.assert_allclose(found, [[0.25, 0.0, 0.0], [2.0, 2.0, 2.0]])
    np.testing.assert_allclose(distance, [1.0, 1.0])


def test_points_on_the_practice_flower_have_no_offset() -> None:
    parts = practice("p1")
    for number, part in enumerate(parts):
        points = part.vertices[part.faces[::7]].mean(axis=1)
        anchor = closest_material(parts, points)
        assert np.abs(anchor.offset).max() < 1e-9
        assert (anchor.part == number).mean() > 0.7  # a face shared with an earlier part is its


def test_bad_input_is_named() -> None:
    part = box([0.0, 0.0, 0.0], [0.01, 0.01, 0.01])
    with pytest.raises(ValueError, match="points: row 0 is not finite"):
        closest_material([part], np.array([[np.inf, 0.0, 0.0]]))
    with pytest.raises(ValueError, match="parts: got none"):
        closest_material([], np.zeros((1, 3)))
    empty = closest_material([part], np.empty((0, 3)))
    assert empty.anchor.shape == (0, 3)
