"""Joints between parts: where they are, how large, and which parts count as touching."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from mphygs.scene.particles import find_joints
from test_scene_particles import Solid, box, practice, solid

SPACING = 0.006


def test_two_boxes_touch_over_the_face_that_they_share() -> None:
    large, small = box([0.0, 0.0, 0.0], [0.03, 0.03, 0.03]), box([0.007, 0.011, 0.03], [0.019, 0.02, 0.05])
    (joint,) = find_joints([large, small], spacing=SPACING)
    assert joint.parts == (0, 1)
    assert joint.area.sum() == pytest.approx(0.012 * 0.009, rel=0.05)
    middle = joint.area @ joint.points / joint.area.sum()
    np.testing.assert_allclose(middle, [0.013, 0.0155, 0.03], atol=1e-4)
    np.testing.assert_allclose(joint.normal, np.tile([0.0, 0.0, 1.0], (len(joint.area), 1)), atol=1e-12)


def test_where_parts_overlap_the_joint_is_the_surface_of_the_earlier_one() -> None:
    ball = solid(trimesh.creation.icosphere(subdivisions=4, radius=0.012))
    bar = box([-0.003, -0.003, 0.0], [0.003, 0.003, 0.03])
    (joint,) = find_joints([ball, bar], spacing=SPACING)
    np.testing.assert_allclose(np.linalg.norm(joint.points, axis=1), 0.012, rtol=2e-3)
    # The patch of the sphere over a square of 6 mm.
    x = (np.arange(60) + 0.5) / 60 * 0.006 - 0.003
    patch = (0.012 / np.sqrt(0.012**2 - x[:, None] ** 2 - x**2)).mean() * 0.006**2
    assert joint.area.sum() == pytest.approx(patch, rel=0.05)
    (other,) = find_joints([bar, ball], spacing=SPACING)
    # The bar's sides and its lower end, inside the ball.
    assert other.area.sum() == pytest.approx(0.006**2 + 4 * 0.006 * 0.0117, rel=0.05)


@pytest.mark.parametrize("second", [0.0048, 0.021], ids=["beside the first", "far from it"])
def test_a_thin_sheet_is_found_and_two_sheets_have_two_joints(second: float) -> None:
    ball = box([0.0, 0.0, 0.0], [0.03, 0.03, 0.02])
    sheets = [box([x, 0.01, 0.02], [x + 3e-4, 0.02, 0.04]) for x in (0.004, second)]
    both = Solid(
        "sheets",
        np.concatenate([s.vertices for s in sheets]),
        np.concatenate([sheets[0].faces, sheets[1].faces + len(sheets[0].vertices)]),
    )
    joints = find_joints([ball, both], spacing=SPACING)
    assert [j.parts for j in joints] == [(0, 1), (0, 1)]
    for joint in joints:
        assert joint.area.sum() == pytest.approx(3e-4 * 0.01, rel=0.25)


def test_one_shell_that_touches_in_two_places_has_two_joints() -> None:
    # A block upon a step at its end and a ledge at the other: one mesh, two faces.
    block = box([0.0, 0.0, 0.01], [0.04, 0.01, 0.02])
    feet = [box([0.0, 0.0, 0.0], [0.01, 0.01, 0.01]), box([0.03, 0.0, 0.0], [0.04, 0.01, 0.01])]
    joints = find_joints([block, *feet], spacing=SPACING)
    assert [j.parts for j in joints] == [(0, 1), (0, 2)]
    bar = box([-0.01, 0.002, 0.002], [0.05, 0.008, 0.008])  # goes through both feet, owned by them
    through = find_joints([feet[0], feet[1], bar], spacing=SPACING)
    assert sorted(j.parts for j in through) == [(0, 2), (0, 2), (1, 2), (1, 2)]


def test_a_part_with_a_hole_inside_is_one_piece() -> None:
    shell = trimesh.creation.box(extents=[0.03] * 3)
    hole = trimesh.creation.box(extents=[0.01] * 3)
    hole.invert()
    hollow = solid(trimesh.util.concatenate([shell, hole]))
    core = box([-0.005] * 3, [0.005] * 3)
    (joint,) = find_joints([hollow, core], spacing=SPACING)
    assert joint.area.sum() == pytest.approx(6 * 0.01**2, rel=0.05)


def test_what_is_held_has_no_joint() -> None:
    left, right = box([0.0, 0.0, 0.0], [0.03, 0.02, 0.02]), box([0.03, 0.0, 0.0], [0.06, 0.02, 0.02])
    hold = np.array([[[-1.0, -1.0, -1.0], [1.0, 1.0, 0.005]]])
    (joint,) = find_joints([left, right], spacing=SPACING, exclude_boxes=hold)
    assert joint.points[:, 2].min() > 0.005
    assert joint.area.sum() == pytest.approx(0.02 * 0.015, rel=0.05)


def test_a_third_part_takes_what_it_owns() -> None:
    first, last = box([0.0, 0.0, 0.0], [0.03, 0.02, 0.02]), box([0.03, 0.0, 0.0], [0.06, 0.02, 0.02])
    between = box([0.025, 0.0, 0.0], [0.035, 0.02, 0.02])
    joints = find_joints([first, between, last], spacing=SPACING)
    assert [j.parts for j in joints] == [(0, 1), (1, 2)]
    # Listed last it owns nothing of the overlap, so the other two touch.
    joints = find_joints([first, last, between], spacing=SPACING)
    assert (0, 1) in [j.parts for j in joints]


@pytest.mark.parametrize("gap", [1e-7, 1e-4, 1e-3])
def test_only_what_nothing_else_holds_is_joined_over_a_gap(gap: float) -> None:
    left, right = box([0.0, 0.0, 0.0], [0.03, 0.02, 0.02]), box([0.03 + gap, 0.0, 0.0], [0.06, 0.02, 0.02])
    assert len(find_joints([left, right], spacing=SPACING, grounded=[0])) == 1
    held = find_joints([left, right], spacing=SPACING, grounded=[0, 1])
    assert len(held) == (1 if gap < 1e-6 else 0)


def test_parts_further_apart_than_a_spacing_stay_apart() -> None:
    left, right = box([0.0, 0.0, 0.0], [0.03, 0.02, 0.02]), box([0.037, 0.0, 0.0], [0.06, 0.02, 0.02])
    assert find_joints([left, right], spacing=SPACING, grounded=[0]) == []


def test_the_practice_flower_hangs_together() -> None:
    parts = practice("p1")
    assert [p.name for p in parts] == ["head", "leaf1", "leaf2", "stem"]
    joints = find_joints(parts, spacing=SPACING, grounded=[3])
    assert [j.parts for j in joints] == [(0, 3), (1, 3), (2, 3)]


def test_a_spacing_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ValueError, match="spacing"):
        find_joints([box([0.0] * 3, [1.0] * 3)], spacing=0.0)
