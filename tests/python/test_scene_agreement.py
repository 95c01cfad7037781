"""Pictures of a motion against the rest views: wrong poses and pictures of something else are found."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from mesh_picture import cameras_around, draw_mesh, dumbbell
from mphygs.capture.annotations import Correspondence
from mphygs.capture.cameras import Camera
from mphygs.capture.errors import CaptureError
from mphygs.capture.rotation import matrix_from_rotation_vector
from mphygs.capture.views import Photograph
from mphygs.scene.agreement import check_first_frame, reprojection_errors, triangulate

SIZE = 64


def photographs(
    cameras: list[Camera], mesh: trimesh.Trimesh, tint: tuple[float, ...] = (1.0, 1.0, 1.0)
) -> list[Photograph]:
    pictures = []
    for camera in cameras:
        colour, mask = draw_mesh(camera, mesh)
        pictures.append(Photograph(camera, colour * tint, mask))
    return pictures


@pytest.fixture(scope="module")
def rest() -> list[Photograph]:
    return photographs(cameras_around(9, SIZE), dumbbell())


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    return cameras_around(5, SIZE, first=0.3)


def pointed_at(cameras: list[Camera], error: float = 0.2) -> list[Correspondence]:
    generator = np.random.default_rng(2)
    points = dumbbell().vertices[::40]
    return [
        Correspondence(
            rest={},
            first={c.name: c.project(p[None])[0][0] + error * generator.standard_normal(2) for c in cameras},
        )
        for p in points
    ]


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera as if it looked elsewhere by that angle."""
    pose = camera.camera_from_world.copy()
    pose[:3] = matrix_from_rotation_vector(np.radians([0.0, degrees, 0.0])) @ pose[:3]
    return replace(camera, camera_from_world=pose)


def test_the_object_moved_and_turned_is_the_object(rest, cameras) -> None:
    moved = dumbbell()
    moved.vertices = moved.vertices @ matrix_from_rotation_vector(np.array([0.2, 0.1, 0.5])).T + 0.005
    found = check_first_frame(rest, photographs(cameras, moved), pointed_at(cameras))
    assert found.size == pytest.approx(1.0, abs=0.25) and found.colours > 0.6
    assert set(found.error) == {c.name for c in cameras} and max(found.error.values()) < 0.6


@pytest.mark.parametrize("wrong", [0, 3])
def test_a_camera_whose_pose_is_wrong_is_named_with_its_error(rest, cameras, wrong) -> None:
    seen = photographs(cameras, dumbbell())
    # the points were pointed at in the pictures as they are; the pose that is stated is another
    points = pointed_at(cameras)
    seen[wrong] = replace(seen[wrong], camera=turned(cameras[wrong], 6.0))
    with pytest.raises(CaptureError) as caught:
        check_first_frame(rest, seen, points, where='sequence "a"')
    message = str(caught.value)
    name = cameras[wrong].name
    assert message.startswith('sequence "a"') and f'camera "{name}" is' in message and "\n" not in message
    # 6 degrees are tan(6 deg) focal lengths
    said = float(message.split("is ")[1].split(" px")[0])
    assert said == pytest.approx(np.tan(np.radians(6.0)) * cameras[wrong].focal[0], rel=0.2)


def test_cameras_that_all_disagree_are_not_blamed_on_one(rest, cameras) -> None:
    seen = photographs(cameras, dumbbell())
    bad = [turned(c, angle) for c, angle in zip(cameras, (9.0, -8.0, 7.0, -9.0, 8.0), strict=True)]
    wrong = [replace(p, camera=c) for p, c in zip(seen, bad, strict=True)]
    with pytest.raises(CaptureError, match="one frame of reference"):
        check_first_frame(rest, wrong, pointed_at(cameras))


def test_a_wrong_pose_is_found_without_points_as_well(rest, cameras) -> None:
    seen = photographs(cameras, dumbbell())
    seen[2] = replace(seen[2], camera=turned(cameras[2], 9.0))
    with pytest.raises(CaptureError, match=f'"{cameras[2].name}"'):
        check_first_frame(rest, seen)


def test_pictures_of_something_else_are_refused(rest, cameras) -> None:
    small = dumbbell().apply_scale(0.5)
    with pytest.raises(CaptureError, match="times as large as the rest views"):
        check_first_frame(rest, photographs(cameras, small))
    green = photographs(cameras, dumbbell(), tint=(0.05, 1.0, 0.05))
    with pytest.raises(CaptureError, match="of its colours in common"):
        check_first_frame(rest, green)


def test_triangulation_and_its_errors(cameras) -> None:
    place = np.array([0.01, -0.02, 0.03])
    pixels = np.array([c.project(place[None])[0][0] for c in cameras])
    assert triangulate(cameras, pixels) == pytest.approx(place, abs=1e-12)
    known = {c.name: c for c in cameras}
    exact = [dict(zip(known, pixels, strict=True))]
    assert max(reprojection_errors(known, exact).values()) < 1e-9
    off = {name: p + [3.0, 0.0] if name == cameras[1].name else p for name, p in exact[0].items()}
    errors = reprojection_errors(known, [off, {cameras[0].name: pixels[0]}])
    assert max(errors, key=errors.__getitem__) == cameras[1].name
    with pytest.raises(ValueError, match="parallel"):
        triangulate([cameras[0], cameras[0]], pixels[[0, 0]])
