"""Folders of rest views and of videos: read, and refused in one clear line."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from mesh_picture import cameras_around, draw_mesh, dumbbell, write_rest_views
from mphygs.capture.cameras import Camera
from mphygs.capture.errors import CaptureError
from mphygs.capture.format import load_capture
from mphygs.capture.images import write_image
from mphygs.capture.transforms import write_transforms
from mphygs.capture.view_folders import load_rest_views, load_sequence_views, rest_views_of, sequence_views_of
from mphygs.capture.views import RestViews, SequenceViews

FRAMES = 3


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    return cameras_around(3, 32)


@pytest.fixture
def rest(tmp_path: Path, cameras: list[Camera]) -> Path:
    write_rest_views(tmp_path, cameras)
    return tmp_path


@pytest.fixture
def film(tmp_path: Path, cameras: list[Camera]) -> Path:
    """A brighter square at every frame and camera, with masks of it."""
    files = []
    for camera in cameras:
        for kind in ("images", "masks"):
            (tmp_path / kind / camera.name).mkdir(parents=True)
        for frame in range(FRAMES):
            mask = np.zeros((32, 32))
            mask[8:20, 8 + frame : 20 + frame] = 1
            name = f"{camera.name}/{frame:03d}.png"
            write_image(tmp_path / "images" / name, 0.2 + 0.1 * frame + 0.5 * mask[..., None].repeat(3, 2))
            write_image(tmp_path / "masks" / name, mask)
            files.append(f"images/{name}")
    several = [camera for camera in cameras for _ in range(FRAMES)]
    write_transforms(tmp_path / "transforms.json", several, files, list(range(FRAMES)) * len(cameras))
    return tmp_path


def film_of(folder: Path, rest: RestViews | None = None) -> SequenceViews:
    return load_sequence_views(folder, frames=FRAMES, rest=rest)


def complaint(load: Callable[[Path], object], folder: Path) -> str:
    with pytest.raises(CaptureError) as caught:
        load(folder)
    line = str(caught.value)
    assert "\n" not in line and "expected" in line and str(folder) in line
    return line


def edit(folder: Path, change: Callable[[list], object]) -> None:
    document = json.loads((folder / "transforms.json").read_text())
    change(document["frames"])
    (folder / "transforms.json").write_text(json.dumps(document))


def test_rest_views(rest: Path, cameras: list[Camera]) -> None:
    views = load_rest_views(rest)
    assert list(views.views) == [camera.name for camera in cameras]
    for photograph, camera in zip(views.read(), cameras, strict=True):
        colour, coverage = draw_mesh(camera, dumbbell())
        np.testing.assert_allclose(photograph.colour, colour, atol=0.003)
        np.testing.assert_allclose(photograph.mask, coverage, atol=0.003)
        small = photograph.shrunk(4)
        assert small.colour.shape == (8, 8, 3) and small.camera.width == 8
        assert small.mask.mean() == pytest.approx(photograph.mask.mean(), abs=1e-5)


@pytest.mark.parametrize("masks", ["alpha", "background"])
def test_masks_of_other_kinds(tmp_path: Path, cameras: list[Camera], masks: str) -> None:
    write_rest_views(tmp_path, cameras, masks=masks)
    for photograph, camera in zip(load_rest_views(tmp_path).read(), cameras, strict=True):
        coverage = draw_mesh(camera, dumbbell())[1]
        both = ((photograph.mask > 0.5) & (coverage > 0.5)).sum()
        either = ((photograph.mask > 0.5) | (coverage > 0.5)).sum()
        assert both / either > (0.999 if masks == "alpha" else 0.8)


def test_lens_distortion_is_undone(tmp_path: Path, cameras: list[Camera]) -> None:
    write_rest_views(tmp_path, cameras)
    plain = load_rest_views(tmp_path).read()[0]
    edit(tmp_path, lambda frames: frames[0].update(k1=-2.0))
    bent = load_rest_views(tmp_path).read()[0]
    assert not bent.camera.distortion.any()
    # a barrel distortion is stretched outwards
    assert bent.mask.sum() > 1.005 * plain.mask.sum() and np.abs(bent.colour - plain.colour).max() > 0.1


def test_rest_views_that_are_refused(rest: Path) -> None:
    write_image(rest / "masks" / "view00.png", np.zeros((32, 32)))
    assert "masks/view00.png: the mask is empty" in complaint(load_rest_views, rest)
    write_image(rest / "masks" / "view00.png", np.ones((16, 32)))
    assert "view00.png: is 32 x 16 pixels; expected 32 x 32" in complaint(load_rest_views, rest)
    (rest / "masks" / "view00.png").unlink()
    assert "has no mask for view00.png" in complaint(load_rest_views, rest)
    for mask in (rest / "masks").iterdir():
        mask.unlink()
    (rest / "masks").rmdir()
    assert "nothing says where the object is in it" in complaint(load_rest_views, rest)
    write_image(rest / "images" / "view00.png", np.ones((16, 16, 3)))
    assert "is 16 x 16 pixels; expected 32 x 32, as camera view00 says" in complaint(load_rest_views, rest)
    edit(rest, lambda frames: frames.append(frames[1]))
    assert 'view "view01" is given twice' in complaint(load_rest_views, rest)
    edit(rest, lambda frames: frames.__delitem__(slice(2, None)))
    assert "has 2 views; expected at least 3" in complaint(load_rest_views, rest)


def test_sequence(film: Path, cameras: list[Camera]) -> None:
    sequence = film_of(film)
    assert sequence.cameras == tuple(camera.name for camera in cameras)
    for frame in range(FRAMES):
        photographs = sequence.read(frame)
        assert [photograph.camera.name for photograph in photographs] == list(sequence.cameras)
        for photograph in photographs:
            assert photograph.mask[10, 8 + frame] == 1 and photograph.mask[10, 7 + frame] == 0
            assert photograph.colour[0, 0, 0] == pytest.approx(0.2 + 0.1 * frame, abs=0.003)
    assert sequence.contact == {} and sequence.correspondences == ()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda frames: frames.pop(4), 'camera "view01" has no frame 1; expected frames 0 to 2 of every'),
        (lambda frames: frames.__delitem__(slice(7, 9)), 'camera "view02" has no frame 1 and 1 more'),
        (lambda frames: frames[2].update(frame=3), "frames[2]: is frame 3; expected a frame of the sequence"),
        (lambda frames: frames[2].update(frame=1), 'frame 1 of camera "view00" is given twice'),
        (lambda frames: frames[5].pop("frame"), "frames[5]: says not which frame it is"),
        (lambda frames: frames.__delitem__(slice(3, None)), "has 1 camera; expected at least 2"),
        (lambda frames: frames[4].update(w=30), 'camera "view01" has pictures of 30 x 32 and 32 x 32 pixels'),
    ],
)
def test_frames_out_of_step(film: Path, change: Callable[[list], object], message: str) -> None:
    edit(film, change)
    assert message in complaint(film_of, film)


def test_a_bad_picture_later_is_refused_when_it_is_read(film: Path) -> None:
    write_image(film / "masks" / "view01" / "002.png", np.zeros((32, 32)))
    sequence = film_of(film)
    assert "masks/view01/002.png: the mask is empty" in complaint(lambda _: sequence.read(2), film)


def test_videos_instead_of_images(tmp_path: Path, cameras: list[Camera]) -> None:
    entries = []
    for kind in ("images", "masks"):
        (tmp_path / kind).mkdir()
        for camera in cameras[:2]:
            path = tmp_path / kind / f"{camera.name}.avi"
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (32, 32))
            for frame in range(FRAMES):
                image = np.zeros((32, 32, 3), np.uint8)
                image[8:24, 8:24] = 255 if kind == "masks" else 80 * frame + 40
                writer.write(image)
            writer.release()
            entries.append(path)
    write_transforms(
        tmp_path / "transforms.json", cameras[:2], ["images/view00.avi", "images/view01.avi"], [None] * 2
    )
    sequence = film_of(tmp_path)
    for frame in (0, 1, 2, 0):
        photographs = sequence.read(frame)
        assert len(photographs) == 2 and 0.2 < photographs[0].mask.mean() < 0.3
        assert photographs[1].colour[16, 16, 1] == pytest.approx((80 * frame + 40) / 255, abs=0.03)
    too_long = complaint(lambda folder: load_sequence_views(folder, frames=5), tmp_path)
    assert "view00.avi: has 3 frames; expected 5, as the sequence" in too_long
    assert "is a video; expected one image a view" in complaint(load_rest_views, tmp_path)


def test_annotations(film: Path, tmp_path_factory: pytest.TempPathFactory, cameras: list[Camera]) -> None:
    folder = tmp_path_factory.mktemp("rest")
    write_rest_views(folder, cameras)
    rest = load_rest_views(folder)
    (film / "contact.json").write_text('{"view01": {"0": [3, 4.5], "2": [32, 0]}}')
    points = [{"rest": {"view00": [1, 2], "view02": [3, 4]}, "first": {"view00": [5, 6], "view01": [7, 8]}}]
    (film / "correspondences.json").write_text(json.dumps(points))
    sequence = film_of(film, rest)
    assert list(sequence.contact["view01"]) == [0, 2]
    np.testing.assert_array_equal(sequence.contact["view01"][0], [3, 4.5])
    (point,) = sequence.correspondences
    np.testing.assert_array_equal(point.rest["view02"], [3, 4])
    np.testing.assert_array_equal(point.first["view01"], [7, 8])
    assert "speaks of rest views, of which there are none" in complaint(film_of, film)

    def spoilt(name: str, content: object) -> str:
        (film / name).write_text(json.dumps(content))
        return complaint(lambda _: film_of(film, rest), film)

    points[0]["first"]["view07"] = [1, 1]
    assert 'there is no view "view07"' in spoilt("correspondences.json", points)
    points[0]["first"] = {"view01": [7, 8]}
    assert "has 1 pixels; expected the point in at least two views" in spoilt("correspondences.json", points)
    assert 'camera "view01" has no frame "3"' in spoilt("contact.json", {"view01": {"3": [1, 1]}})
    assert 'there is no camera "left"' in spoilt("contact.json", {"left": {"0": [1, 1]}})
    assert "expected a pixel within 32 x 32" in spoilt("contact.json", {"view01": {"0": [40, 1]}})


def test_views_of_a_capture(
    film: Path, tmp_path_factory: pytest.TempPathFactory, cameras: list[Camera]
) -> None:
    folder = tmp_path_factory.mktemp("capture")
    write_rest_views(folder / "rest", cameras)
    film.rename(folder / "film")
    document = {
        "format": "mphygs-capture/1",
        "name": "square",
        "gravity": [0, 0, -9.81],
        "object": {"views": "rest", "rest": "equilibrium"},
        "sequences": [
            {"name": "a", "fps": 30, "frames": FRAMES, "fit": [0, 2], "views": "film"},
            {"name": "b", "fps": 30, "frames": FRAMES + 1, "fit": [0, 2], "views": "film"},
            {"name": "c", "fps": 30, "frames": 3},
        ],
    }
    (folder / "capture.json").write_text(json.dumps(document))
    capture = load_capture(folder)
    rest = rest_views_of(capture)
    assert len(rest.views) == 3 and sequence_views_of(capture.sequence("a"), rest).frames == FRAMES
    with pytest.raises(CaptureError, match='camera "view00" has no frame 3'):
        sequence_views_of(capture.sequence("b"), rest)
    with pytest.raises(CaptureError, match='sequence "c": has no views'):
        sequence_views_of(capture.sequence("c"), rest)
    with pytest.raises(CaptureError, match="has no dense rest views; expected object.views"):
        rest_views_of(dataclasses.replace(capture, views=None))
