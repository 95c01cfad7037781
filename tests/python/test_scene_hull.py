"""The visual hull, and the view it names when cameras and masks do not belong together."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from mesh_picture import cameras_around, draw_mesh, dumbbell
from mphygs.capture.cameras import Camera
from mphygs.capture.colmap import ColmapPoints
from mphygs.capture.errors import CaptureError
from mphygs.capture.views import Photograph
from mphygs.scene.first_gaussians import first_points, gaussians_at, mean_features
from mphygs.scene.hull import silhouette_votes, visual_hull


@pytest.fixture(scope="module")
def photographs() -> list[Photograph]:
    pictures = []
    for camera in cameras_around(9, 48):
        colour, coverage = draw_mesh(camera, dumbbell())
        pictures.append(Photograph(camera, colour.astype(np.float32), coverage.astype(np.float32)))
    return pictures


def test_the_hull_holds_the_object_and_little_more(photographs: list[Photograph]) -> None:
    hull = visual_hull(photographs, resolution=40)
    bounds = dumbbell().bounds
    margin = 2 * hull.spacing
    assert hull.spacing < 0.0035 and max(hull.occupied.shape) == 40
    np.testing.assert_allclose([hull.centres.min(0), hull.centres.max(0)], bounds, atol=margin)
    inside = np.array([[0.03, 0.0, 0.005], [-0.035, 0.005, 0.0], [0.0, 0.0, 0.0]])
    nearest = np.linalg.norm(hull.centres[None] - inside[:, None], axis=2).min(axis=1)
    assert (nearest < hull.spacing).all()
    surface = hull.surface
    assert 0.1 < len(surface) / len(hull.centres) < 0.6
    assert np.linalg.norm(surface - inside[0], axis=1).min() > 0.02


@pytest.mark.parametrize("wrong", [0, 4])
def test_a_wrong_pose_is_named(photographs: list[Photograph], wrong: int) -> None:
    camera = photographs[wrong].camera
    pose = camera.camera_from_world.copy()
    pose[1, 3] += 0.03
    spoilt = list(photographs)
    spoilt[wrong] = dataclasses.replace(
        photographs[wrong], camera=dataclasses.replace(camera, camera_from_world=pose)
    )
    with pytest.raises(CaptureError, match=f'without view "view0{wrong}" the others agree') as caught:
        visual_hull(spoilt, resolution=40)
    assert "\n" not in str(caught.value) and "expected the pose or the mask" in str(caught.value)


def test_views_of_nothing_in_common(photographs: list[Photograph]) -> None:
    flat = Camera("flat", 48, 48, np.full(2, 90.0), np.full(2, 24.0), photographs[0].camera.camera_from_world)
    same = [dataclasses.replace(photographs[0], camera=flat) for _ in range(3)]
    with pytest.raises(CaptureError, match="3 views: look along one direction; expected cameras and masks"):
        visual_hull(same)
    with pytest.raises(ValueError, match="resolution: 1"):
        visual_hull(photographs, resolution=1)


def test_first_points_are_coloured_by_what_is_seen(photographs: list[Photograph]) -> None:
    plain = [dataclasses.replace(p, colour=np.full_like(p.colour, 0.25)) for p in photographs]
    positions, colours = first_points(plain, None, resolution=24)
    assert len(positions) == len(colours) > 200
    np.testing.assert_allclose(colours, 0.25, atol=1e-6)
    within, seen = silhouette_votes(photographs, np.array([[0.03, 0.0, 0.005], [0.0, 0.058, 0.0]]))
    assert within.tolist() == [9, 0] and seen[0] == 9
    within, _ = silhouette_votes(photographs, positions)
    assert (within >= 2).mean() > 0.95


def test_points_of_colmap_come_first_when_they_are_enough(photographs: list[Photograph]) -> None:
    draw = np.random.default_rng(0)
    ball = draw.normal(size=(300, 3))
    inside = 0.02 * ball / np.linalg.norm(ball, axis=1, keepdims=True) + [0.03, 0, 0.005]
    places = np.concatenate([inside, inside + 0.05])
    points = ColmapPoints(places, draw.uniform(size=(600, 3)), np.arange(600))
    positions, colours = first_points(photographs, points, resolution=24)
    np.testing.assert_array_equal(positions, inside)
    np.testing.assert_array_equal(colours, points.colours[:300])
    few = ColmapPoints(inside[:50], points.colours[:50], points.numbers[:50])
    assert len(first_points(photographs, few, resolution=24)[0]) != 50


def test_first_gaussians(photographs: list[Photograph]) -> None:
    lattice = 0.01 * np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3)
    first = gaussians_at(lattice, np.full((64, 3), 0.75), np.ones((64, 2)))
    torch.testing.assert_close(first.scales, torch.full((64, 3), 0.01))
    assert first.degree == 0 and first.features.shape == (64, 2)
    with pytest.raises(ValueError, match="3 points; expected at least 4"):
        gaussians_at(lattice[:3], np.zeros((3, 3)), np.zeros((3, 0)))


def test_features_are_the_mean_of_what_the_views_show(photographs: list[Photograph]) -> None:
    maps = [torch.full((12, 12, 2), float(index)) for index in range(9)]
    maps[0][..., 1] = 9.0
    point = np.array([[0.03, 0.0, 0.005], [0.0, 0.058, 0.0]])
    features = mean_features(photographs, maps, point)
    assert features[0, 0] == pytest.approx(4.0) and features[0, 1] == pytest.approx(5.0)
    assert not features[1].any(), "this point is in no mask"
