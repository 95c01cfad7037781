"""Exposed surface against closed form and against counting voxel faces."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from mphygs.scene.particles import exposed_surface
from test_scene_particles import Solid, box, practice, solid, turned


def test_a_box_alone_is_exposed_all_over() -> None:
    part = box([0.0, 0.0, 0.0], [0.02, 0.03, 0.01])
    samples = exposed_surface([part], max_edge=0.003)
    assert samples.area.sum() == pytest.approx(2 * (6e-4 + 2e-4 + 3e-4), rel=1e-12)
    assert samples.area.max() <= 0.003**2 * (1 + 1e-9)
    for axis, area in ((0, 3e-4), (1, 2e-4), (2, 6e-4)):
        for sign in (-1.0, 1.0):
            face = np.isclose(samples.normal[:, axis], sign)
            assert samples.area[face].sum() == pytest.approx(area, rel=1e-12)
            middle = samples.area[face] @ samples.points[face] / samples.area[face].sum()
            expected = np.array([0.01, 0.015, 0.005])
            expected[axis] = 0.0 if sign < 0 else [0.02, 0.03, 0.01][axis]
            np.testing.assert_allclose(middle, expected, atol=1e-12)


def test_normals_point_outward_and_close() -> None:
    mesh = turned(trimesh.creation.icosphere(subdivisions=3, radius=0.02))
    samples = exposed_surface([solid(mesh)], max_edge=0.001)
    assert samples.area.sum() == pytest.approx(mesh.area, rel=1e-12)
    np.testing.assert_allclose(samples.area @ samples.normal, 0.0, atol=1e-15)
    # divergence theorem: a third of the flux of the position is the volume
    flux = samples.area @ np.einsum("si,si->s", samples.points, samples.normal) / 3.0
    assert flux == pytest.approx(mesh.volume, rel=1e-10)


def test_the_interface_of_two_boxes_is_not_exposed_even_where_sizes_differ() -> None:
    large, small = box([0.0, 0.0, 0.0], [0.03, 0.03, 0.03]), box([0.007, 0.011, 0.03], [0.019, 0.02, 0.05])
    samples = exposed_surface([large, small], max_edge=0.0031)
    interface = 0.012 * 0.009
    by_part = np.bincount(samples.part, weights=samples.area)
    assert by_part[0] == pytest.approx(6 * 9e-4 - interface, rel=1e-10)
    assert by_part[1] == pytest.approx(2 * 0.02 * (0.012 + 0.009) + interface, rel=1e-10)
    apart = exposed_surface([large, Solid("up", small.vertices + [0, 0, 1e-3], small.faces)], max_edge=0.0031)
    assert apart.area.sum() == pytest.approx(samples.area.sum() + 2 * interface, rel=1e-10)


def test_a_gap_or_overlap_far_below_the_sample_is_contact() -> None:
    large, small = box([0.0, 0.0, 0.0], [0.03, 0.03, 0.03]), box([0.007, 0.011, 0.03], [0.019, 0.02, 0.05])
    exposed = 6 * 9e-4 + 2 * 0.02 * (0.012 + 0.009)
    for shift in (1e-8, -1e-8, -5e-4):
        moved = Solid("moved", small.vertices + [0.0, 0.0, shift], small.faces)
        found = exposed_surface([large, moved], max_edge=0.003).area.sum()
        assert found == pytest.approx(exposed - 2 * 0.021 * max(-shift, 0.0), rel=1e-6)


def test_held_material_is_not_exposed() -> None:
    part = box([0.0, 0.0, 0.0], [0.1, 0.03, 0.02])
    hold = np.array([[[0.0, 0.0, 0.0], [0.0137, 0.03, 0.02]]])
    samples = exposed_surface([part], max_edge=0.004, exclude_boxes=hold)
    assert samples.area.sum() == pytest.approx(2 * (0.1 - 0.0137) * 0.05 + 6e-4, rel=1e-10)
    assert samples.points[:, 0].min() > 0.0137
    window = np.array([[[0.04, -1.0, 0.01], [0.05, 0.01, 1.0]]])
    around = exposed_surface([part], max_edge=0.004, exclude_boxes=window)
    whole = 2 * (0.1 * 0.05 + 6e-4)
    assert around.area.sum() == pytest.approx(whole - 2 * 0.01 * 0.01, rel=1e-10)
    outside = np.array([[[0.1, 0.0, 0.0], [0.2, 0.03, 0.02]]])  # touches the end, holds nothing of it
    assert exposed_surface([part], max_edge=0.004, exclude_boxes=outside).area.sum() == pytest.approx(whole)


def voxel_faces_exposed(parts: list[Solid]) -> float:
    """Area of the voxel faces that occur once, each put together from the two triangles at its diagonal."""
    vertices = np.concatenate([part.vertices for part in parts])
    name = np.arange(len(vertices))
    for one, other in sorted(cKDTree(vertices).query_pairs(2e-6)):
        name[other] = min(name[other], name[one])
    faces: dict[frozenset, list[float]] = defaultdict(list)
    start = 0
    for part in parts:
        halves = defaultdict(list)
        for triangle in part.faces:
            corners = part.vertices[triangle]
            cross = np.cross(corners[1] - corners[0], corners[2] - corners[0])
            longest = int(np.argmax(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)))
            names = name[triangle + start]
            diagonal = frozenset((names[longest], names[(longest + 1) % 3]))
            halves[diagonal].append((frozenset(names), cross))
        for pending in halves.values():
            while pending:
                names, cross = pending.pop()
                partner = max(range(len(pending)), key=lambda k: float(pending[k][1] @ cross))
                other_names, other_cross = pending.pop(partner)
                faces[names | other_names].append(0.5 * (np.linalg.norm(cross) + np.linalg.norm(other_cross)))
        start += len(part.vertices)
    return float(sum(areas[0] for areas in faces.values() if len(areas) == 1))


@pytest.mark.parametrize("name", ["p1", "p3"])
def test_practice_surface_is_that_of_the_voxel_faces_met_once(name: str) -> None:
    parts = practice(name)
    samples = exposed_surface(parts, max_edge=0.003)
    whole = sum(trimesh.Trimesh(part.vertices, part.faces).area for part in parts)
    expected = voxel_faces_exposed(parts)
    assert expected < 0.96 * whole
    assert samples.area.sum() == pytest.approx(expected, rel=1e-5)


def test_bad_input_is_named() -> None:
    part = box([0.0, 0.0, 0.0], [0.01, 0.01, 0.01])
    with pytest.raises(ValueError, match="max_edge: got 0"):
        exposed_surface([part], max_edge=0.0)
    with pytest.raises(ValueError, match="exclude_boxes: expected an"):
        exposed_surface([part], max_edge=0.01, exclude_boxes=np.zeros((3, 3)))
    assert len(exposed_surface([], max_edge=0.01).area) == 0
