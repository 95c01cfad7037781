"""The faces through which a hold grips free material."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from mphygs.capture.meshes import Part
from mphygs.scene.particles import hold_face
from test_scene_particles import SHARED, box, practice, solid, turned
from thin_meshes import rod, strip


def test_a_clamped_end_has_one_face() -> None:
    beam = box([-0.1, 0.0, 0.0], [0.0, 0.03, 0.02])
    (face,) = hold_face([beam], np.array([[-0.1, 0.0, 0.0], [-0.0937, 0.03, 0.02]]), spacing=0.006)
    assert (face.axis, face.coordinate) == (0, -0.0937)
    assert face.area.sum() == pytest.approx(0.03 * 0.02, rel=1e-10)
    assert np.all(face.points[:, 0] == -0.0937)
    np.testing.assert_allclose(face.area @ face.points[:, 1:] / face.area.sum(), [0.015, 0.01], rtol=1e-10)
    assert face.area.max() <= (0.006 / 6) ** 2 * (1 + 1e-9)
    assert len(face.points) == 30 * 20


def test_a_box_larger_than_the_object_gives_the_same_face() -> None:
    beam = box([-0.1, 0.0, 0.0], [0.0, 0.03, 0.02])
    (face,) = hold_face([beam], np.array([[-1.0, -1.0, -1.0], [-0.094, 1.0, 1.0]]), spacing=0.006)
    assert (face.axis, face.coordinate) == (0, -0.094)
    assert face.area.sum() == pytest.approx(0.03 * 0.02, rel=1e-10)


def test_a_box_in_the_middle_has_every_face_that_is_inside_the_solid() -> None:
    beam = box([0.0, 0.0, 0.0], [0.1, 0.03, 0.02])
    faces = hold_face([beam], np.array([[0.04, 0.01, -1.0], [0.06, 1.0, 1.0]]), spacing=0.004)
    assert [(face.axis, face.coordinate) for face in faces] == [(0, 0.04), (0, 0.06), (1, 0.01)]
    np.testing.assert_allclose([face.area.sum() for face in faces], [4e-4, 4e-4, 4e-4], rtol=1e-10)
    assert len(hold_face([beam], np.array([[0.04, 0.01, 0.005], [0.06, 0.02, 0.015]]), spacing=0.004)) == 6


def test_an_interface_between_parts_is_material_on_both_sides() -> None:
    left, right = box([0.0, 0.0, 0.0], [0.05, 0.03, 0.02]), box([0.05, 0.0, 0.0], [0.1, 0.02, 0.02])
    (face,) = hold_face([left, right], np.array([[-1.0, -1.0, -1.0], [0.05, 1.0, 1.0]]), spacing=0.006)
    assert face.area.sum() == pytest.approx(0.02 * 0.02, rel=1e-10)  # only where the right part goes on
    assert face.points[:, 1].max() < 0.02


def test_nothing_is_gripped_through_the_own_surface_or_another_hold() -> None:
    beam = box([0.0, 0.0, 0.0], [0.1, 0.03, 0.02])
    whole = np.array([[0.0, 0.0, 0.0], [0.1, 0.03, 0.02]])
    assert hold_face([beam], whole, spacing=0.006) == []
    assert hold_face([beam], whole + 1.0, spacing=0.006) == []
    next_to = np.array([[[0.02, -1.0, -1.0], [0.04, 1.0, 1.0]]])
    first = np.array([[-1.0, -1.0, -1.0], [0.02, 1.0, 1.0]])
    assert hold_face([beam], first, spacing=0.006, other_boxes=next_to) == []
    half = np.array([[[0.02, -1.0, -1.0], [0.04, 0.011, 1.0]]])
    (face,) = hold_face([beam], first, spacing=0.006, other_boxes=half)
    assert face.area.sum() == pytest.approx(0.019 * 0.02, rel=1e-10)


def test_area_of_a_slanted_cylinder() -> None:
    mesh = turned(trimesh.creation.cylinder(radius=0.012, height=0.05, sections=64))
    axis = trimesh.transformations.rotation_matrix(0.7, [1.0, 2.0, -0.5])[:3, 2]
    level = mesh.center_mass[2]
    # midpoints resolve a round section only as finely as their number allows
    (face,) = hold_face([solid(mesh)], np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, level]]), spacing=0.0015)
    assert face.axis == 2
    assert face.area.sum() == pytest.approx(np.pi * 0.012**2 / axis[2], rel=5e-3)


def test_practice_flower_is_held_by_its_stem() -> None:
    parts = practice("p1")
    (face,) = hold_face(parts, np.array([[-0.013, -0.013, -0.001], [0.013, 0.013, 0.006]]), spacing=0.006)
    assert (face.axis, face.coordinate) == (2, 0.006)
    stem = next(part for part in parts if part.name == "stem")
    # the held end is an upright prism of voxels: its section is its footprint
    corners = stem.vertices[stem.faces]
    foot = corners[np.abs(corners[:, :, 2]).max(axis=1) < 1e-9]
    footprint = 0.5 * np.abs(np.cross(foot[:, 1] - foot[:, 0], foot[:, 2] - foot[:, 0])[:, 2]).sum()
    assert footprint > 1e-4
    assert face.area.sum() == pytest.approx(footprint, rel=1e-6)


def test_silicone_beam_is_held_by_its_section() -> None:
    file = Path(SHARED / "silicone-beam" / "beam.ply")
    if not file.is_file():
        pytest.skip("the silicone beam is not beside this checkout")
    hold = np.array([[-0.1, 0.0, 0.0], [-0.094, 0.03, 0.03]])
    (face,) = hold_face([solid(trimesh.load(file))], hold, spacing=0.006)
    assert (face.axis, face.coordinate) == (0, -0.094)
    assert face.area.sum() == pytest.approx(9e-4, rel=1e-6)


def test_a_face_along_a_sheet_has_no_more_points_than_its_width_asks_for() -> None:
    """The hold's box ends in the middle of the sheet, over a quarter of its length."""
    sheet = strip(length=0.03, width=0.02, thickness=3e-4)
    faces = hold_face([sheet], np.array([[-1.0, -1.0, -1.0], [0.0, 1.0, 0.0]]), spacing=0.006)
    along, across = (next(face for face in faces if face.axis == axis) for axis in (2, 0))
    assert along.area.sum() == pytest.approx(0.01 * 0.02, rel=1e-9)
    assert len(along.points) == 10 * 20
    assert across.area.sum() == pytest.approx(0.02 * 1.5e-4, rel=1e-9)


@pytest.mark.parametrize("part", [strip(thickness=3e-4), rod(radius=0.0015)], ids=["sheet", "rod"])
def test_a_thin_section_has_some_points_across(part: Part) -> None:
    (face,) = hold_face([part], np.array([[-1.0, -1.0, -1.0], [0.003, 1.0, 1.0]]), spacing=0.006)
    assert len(np.unique(face.points[:, 2])) >= 4


def test_bad_input_is_named() -> None:
    part = box([0.0, 0.0, 0.0], [0.01, 0.01, 0.01])
    with pytest.raises(ValueError, match="box: expected a positive extent"):
        hold_face([part], np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 1.0]]), spacing=0.01)
    with pytest.raises(ValueError, match="box: expected an"):
        hold_face([part], np.zeros(6), spacing=0.01)
    with pytest.raises(ValueError, match="spacing: got 0"):
        hold_face([part], np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]), spacing=0.0)
