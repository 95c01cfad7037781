"""The rigid motion from rest to frame 0: by points in closed form, and by pictures of a rod."""

import numpy as np
import pytest

import rod_video
from mphygs.capture.annotations import Correspondence
from mphygs.capture.rotation import matrix_from_rotation_vector, rotation_vector_from_matrix
from mphygs.motion.alignment import AlignmentRule
from mphygs.motion.rigid import (
    RigidMotion,
    found_rigid,
    pointed_at,
    refined_rigid,
    robust_rigid,
    unlikeness,
)

TURN = matrix_from_rotation_vector(np.array([0.4, -0.9, 1.3]))
TRUE = RigidMotion(TURN, np.array([0.02, -0.3, 0.11]))


def cloud(count: int = 12) -> np.ndarray:
    return np.random.default_rng(5).uniform(-0.1, 0.1, (count, 3))


def apart(found: RigidMotion, true: RigidMotion) -> tuple[float, float]:
    """Angle [rad], and the shift of the rod's middle [m], between two motions."""
    angle = float(np.linalg.norm(rotation_vector_from_matrix(found.rotation @ true.rotation.T)))
    middle = np.array([[0.5 * rod_video.LENGTH, 0.0, 0.0]])
    return angle, float(np.linalg.norm(found.of(middle) - true.of(middle)))


def test_points_pointed_at_give_the_exact_pose() -> None:
    rest, first = rod_video.cameras(4, name="rest"), rod_video.cameras(3, name="camera")
    points = rod_video.LENGTH * np.random.default_rng(1).uniform(-0.5, 0.5, (6, 3)) + [0.05, 0.0, 0.0]
    true = RigidMotion(matrix_from_rotation_vector(np.array([0.2, 0.1, -0.3])), np.array([0.01, 0.0, -0.02]))
    correspondences = [
        Correspondence(
            {c.name: c.project(point[None])[0][0] for c in rest[: 2 + k % 3]},
            {c.name: c.project(true.of(point[None]))[0][0] for c in first[: 2 + k % 2]},
        )
        for k, point in enumerate(points)
    ]
    source, target = pointed_at(
        correspondences, {c.name: c for c in rest}, {c.name: c for c in first}
    )
    assert source == pytest.approx(points, abs=1e-12)
    assert target == pytest.approx(true.of(points), abs=1e-12)
    motion, agree = robust_rigid(source, target)
    assert agree.all()
    assert motion.rotation == pytest.approx(true.rotation, abs=1e-11)
    assert motion.shift == pytest.approx(true.shift, abs=1e-12)


@pytest.mark.parametrize("wrong", [(0,), (3, 7), (1, 2, 8, 11)])
def test_points_that_do_not_belong_together_are_refused(wrong: tuple[int, ...]) -> None:
    source = cloud()
    target = TRUE.of(source)
    target[list(wrong)] += np.array([0.03, -0.05, 0.02])  # all in the same way, as another object would
    motion, agree = robust_rigid(source, target)
    assert np.flatnonzero(~agree).tolist() == sorted(wrong)
    assert motion.rotation == pytest.approx(TRUE.rotation, abs=1e-10)
    assert motion.shift == pytest.approx(TRUE.shift, abs=1e-10)


def test_points_a_little_off_are_all_used() -> None:
    source = cloud(40)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(source.shape)
    motion, agree = robust_rigid(source, TRUE.of(source) + noise)
    assert agree.mean() > 0.95
    # the mean of 40 points is good to sigma / sqrt(40)
    away = motion.of(source).mean(axis=0) - TRUE.of(source).mean(axis=0)
    assert np.abs(away).max() < 4e-3 / np.sqrt(40)


def test_four_points_with_one_of_them_wrong() -> None:
    source = cloud(4)
    target = TRUE.of(source)
    target[2, 1] += 0.05
    motion, agree = robust_rigid(source, target)
    assert agree.tolist() == [True, True, False, True]
    assert motion.rotation == pytest.approx(TRUE.rotation, abs=1e-9)


def test_points_on_a_line_fix_no_rotation() -> None:
    line = np.linspace(0.0, 1.0, 5)[:, None] * np.array([0.1, 0.2, 0.0])
    with pytest.raises(ValueError, match="5 points do not fix a rotation; expected three that are not on"):
        robust_rigid(line, TRUE.of(line))


@pytest.fixture(scope="module")
def gaussians():
    return rod_video.gaussians(1200)


def pictures(true: RigidMotion, *, cameras: int = 4, size: int = 128):
    mesh = rod_video.rod()
    places = true.of(np.asarray(mesh.vertices))
    return [rod_video.photograph(camera, mesh, places) for camera in rod_video.cameras(cameras, size)]


def test_pictures_refine_a_pose(gaussians) -> None:
    turn = matrix_from_rotation_vector(np.array([0.05, -0.04, 0.06]))
    true = RigidMotion(turn, np.array([0.0, 0.003, 0.002]))
    start = RigidMotion(np.eye(3), np.zeros(3))
    seen = pictures(true)
    assert apart(start, true)[0] > 0.08 and apart(start, true)[1] > 3e-3
    found = refined_rigid(gaussians, seen, start, AlignmentRule())
    angle, shift = apart(found, true)
    assert angle < 0.015 and shift < 3e-4, "a fifth of a pixel is 0.25 mm"
    assert unlikeness(found.of_gaussians(gaussians), seen) < 0.5 * unlikeness(gaussians, seen)


def test_a_pose_is_found_where_nobody_pointed_at_anything(gaussians) -> None:
    turn = matrix_from_rotation_vector(np.array([0.1, 0.15, 0.0])) @ np.array(
        [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    )
    middle = np.array([0.5 * rod_video.LENGTH, 0.0, 0.0])
    true = RigidMotion(turn, middle + [0.004, 0.006, -0.005] - turn @ middle)
    found = found_rigid(gaussians, pictures(true), AlignmentRule())
    angle, shift = apart(found, true)
    assert angle < 0.025 and shift < 4e-4
