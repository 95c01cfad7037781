"""Folders of views and videos as people have them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from mphygs.capture.cameras import opengl_of_camera
from mphygs.capture.errors import CaptureError
from mphygs.capture.files import colmap_folder
from mphygs.capture.images import Video, write_image
from mphygs.capture.masks import check_masks, mask_of_picture
from mphygs.capture.transforms import read_transforms
from mphygs.capture.view_folders import load_rest_views, load_sequence_views
from views_example import COUNT, SIZE, Rest, camera, picture

NERFSTUDIO = {
    "camera_model": "OPENCV", "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "applied_transform": [[1, 0, 0, 0]],
    "ply_file_path": "sparse_pc.ply",
}  # fmt: skip
INSTANT_NGP = {
    "camera_angle_x": 0.5, "camera_angle_y": 0.5, "k1": 0, "k2": 0, "k3": 0, "k4": 0, "p1": 0, "p2": 0,
    "is_fisheye": False, "aabb_scale": 16, "n_extra_learnable_dims": 0, "enable_depth_loading": True,
    "integer_depth_scale": 0.001,
}  # fmt: skip
POLYCAM = {"camera_model": "OPENCV", "orientation_override": "none", "auto_scale_poses_override": False}


@pytest.mark.parametrize(
    ("root", "frame"),
    [
        (NERFSTUDIO, {"colmap_im_id": 3}),
        (INSTANT_NGP, {"sharpness": 31.5}),
        (
            POLYCAM,
            {"timestamp": 12345, "blur_score": 0.3, "depth_file_path": "d.png", "manual_keyframe": True},
        ),
        ({}, {"time": 0.0, "rotation": 0.0125}),
    ],
)
def test_what_other_programs_write_beside_is_passed_over(root: dict, frame: dict, tmp_path: Path) -> None:
    rest = Rest(tmp_path)
    rest.document |= root
    for entry in rest.document["frames"]:
        entry |= frame
    assert len(load_rest_views(rest.write()).read()) == COUNT


@pytest.mark.parametrize(
    ("root", "words"),
    [
        ({"is_fisheye": "no"}, 'is_fisheye: is "no"; expected true or false'),
        ({"camera_model": "FISHEYE624"}, 'camera_model: is "FISHEYE624"'),
        ({"k4": 0.1}, "k4: is 0.1"),
        ({"w": 10**6, "h": 10**6}, "pixels"),
    ],
)
def test_lenses_that_are_refused_by_name(root: dict, words: str, tmp_path: Path) -> None:
    rest = Rest(tmp_path)
    rest.document |= root
    assert words in rest.complaint()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".jpeg"])
def test_pictures_named_without_their_ending(suffix: str, tmp_path: Path) -> None:
    rest = Rest(tmp_path, [f"train/r_{k}{suffix}" for k in range(COUNT)])
    shutil.rmtree(tmp_path / "train")
    for name in ("train", *(("masks",) if suffix != ".png" else ())):
        (tmp_path / name).mkdir()
    for k, entry in enumerate(rest.document["frames"]):
        entry["file_path"] = f"./train/r_{k}"
        colour, mask = picture()
        values = np.concatenate([colour, mask[..., None]], axis=2) if suffix == ".png" else colour
        write_image(tmp_path / "train" / f"r_{k}{suffix}", values)
        if suffix != ".png":
            write_image(tmp_path / "masks" / f"r_{k}.png", mask)
    rest.document = {"camera_angle_x": 0.5, "frames": rest.document["frames"]}
    views = load_rest_views(rest.write())
    assert list(views.views) == [f"r_{k}" for k in range(COUNT)]
    found = views.views["r_0"].camera
    assert (found.width, found.height) == (SIZE, SIZE)
    assert found.focal[0] == pytest.approx(0.5 * SIZE / np.tan(0.25))
    (tmp_path / "train" / f"r_3{suffix}").unlink()
    assert '"./train/r_3" does not exist' in rest.complaint()


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ([f"images/cam{k}/000000.png" for k in range(COUNT)], [f"cam{k}-000000" for k in range(COUNT)]),
        ([f"images/cam{k}/a.png" for k in range(COUNT)], [f"cam{k}-a" for k in range(COUNT)]),
        (
            ["images/a/x.png", "images/b/x.png", *(f"images/y{k}.png" for k in range(4))],
            ["a-x", "b-x", *(f"y{k}" for k in range(4))],
        ),
    ],
)
def test_pictures_of_one_name_in_several_folders(
    names: list[str], expected: list[str], tmp_path: Path
) -> None:
    views = load_rest_views(Rest(tmp_path, names).write())
    assert list(views.views) == expected and len(views.read()) == COUNT


def test_one_view_given_twice_is_refused(tmp_path: Path) -> None:
    rest = Rest(tmp_path)
    for entry in rest.document["frames"][:2]:
        entry["camera"] = "left"
    assert 'view "left" is given twice' in rest.complaint()


@pytest.mark.parametrize(("unit", "factor"), [(1e3, "0.001"), (1e6, None), (1e-4, "1000")])
def test_cameras_in_another_unit(unit: float, factor: str | None, tmp_path: Path) -> None:
    line = Rest(tmp_path, unit=unit).complaint()
    assert "by its cameras the object is" in line and "m across; expected 0.001 to 20 m" in line
    assert ("units look off by 1000" in line) == (factor is not None)
    assert factor is None or f"set scale to {factor} times its value" in line


@pytest.mark.parametrize("unit", [0.05, 1.0, 20.0])
def test_cameras_in_metres(unit: float, tmp_path: Path) -> None:
    assert len(load_rest_views(Rest(tmp_path, unit=unit).write()).read()) == COUNT


def test_masks_of_zero_and_one(tmp_path: Path) -> None:
    rest = Rest(tmp_path)
    _, mask = picture()
    for name in rest.names:
        cv2.imwrite(str(tmp_path / name.replace("images", "masks")), mask.astype(np.uint8))
    photographs = load_rest_views(rest.write()).read()
    assert all(np.array_equal(p.mask >= 0.5, mask >= 0.5) for p in photographs)


def test_masks_that_are_inverted(tmp_path: Path) -> None:
    rest = Rest(tmp_path)
    for name in rest.names:
        write_image(tmp_path / name.replace("images", "masks"), 1.0 - picture()[1])
    assert "6 of 6 masks are white all round and black inside: they look inverted" in rest.complaint()


@pytest.mark.parametrize("k1", [1e300, 1e9, -1e6])
def test_lenses_that_no_camera_has(k1: float, tmp_path: Path) -> None:
    rest = Rest(tmp_path)
    rest.document["k1"] = k1
    assert "is left once the lens distortion of view0 is undone" in rest.complaint()


def test_masks_that_show_no_edge_at_all(tmp_path: Path) -> None:
    rest = Rest(tmp_path)
    for name in rest.names:
        write_image(tmp_path / name.replace("images", "masks"), np.ones((SIZE, SIZE)))
    assert "all 6 masks are white all over: nowhere does the object end" in rest.complaint()


def test_masks_of_objects_that_fill_the_view_are_taken() -> None:
    whole = np.ones((20, 30))
    ring = whole.copy()
    ring[8:12, 10:20] = 0.0
    edge = whole.copy()
    edge[:, :6] = 0.0
    check_masks("m", [whole] * 4 + [edge])
    check_masks("m", [edge] * 5)
    check_masks("m", [ring, edge, edge, whole])
    with pytest.raises(CaptureError, match="look inverted"):
        check_masks("m", [ring] * 4 + [whole])


def test_an_empty_mask_stays_empty() -> None:
    from mphygs.capture.images import Pixels

    assert not mask_of_picture(Pixels(np.zeros((4, 4, 3), np.float32), None)).any()


@pytest.mark.parametrize(
    "where", ["sparse/0", "sparse", "sparse/1", "colmap/sparse/0", "colmap/sparse", "colmap"]
)
def test_where_colmap_and_its_wrappers_put_a_model(where: str, tmp_path: Path) -> None:
    rest = Rest(tmp_path)
    model = rest.write_colmap(where, f"PINHOLE {SIZE} {SIZE} 60 60 {SIZE / 2} {SIZE / 2}")
    assert colmap_folder(tmp_path) == model
    assert len(load_rest_views(tmp_path).read()) == COUNT


def test_a_folder_without_a_model(tmp_path: Path) -> None:
    (tmp_path / "sparse" / "3").mkdir(parents=True)
    assert colmap_folder(tmp_path) is None


# ---- videos -----------------------------------------------------------------------------------
def film(folder: Path, frames: int) -> Path:
    """Two videos of so many frames, with a picture of the background for each."""
    (folder / "background").mkdir(parents=True)
    entries = []
    for k in range(2):
        name = f"cam{k}.avi"
        writer = cv2.VideoWriter(str(folder / name), cv2.VideoWriter_fourcc(*"MJPG"), 25, (SIZE, SIZE))
        for frame in range(frames):
            image = np.zeros((SIZE, SIZE, 3), np.uint8)
            image[8:20, 8:20] = 120 + 10 * frame
            writer.write(image)
        writer.release()
        write_image(folder / "background" / f"cam{k}.png", np.zeros((SIZE, SIZE, 3)))
        entries.append(
            {"file_path": name, "camera": f"cam{k}", "transform_matrix": opengl_of_camera(camera(k)).tolist()}
        )
    document = {"w": SIZE, "h": SIZE, "fl_x": 60.0, "frames": entries}
    (folder / "transforms.json").write_text(json.dumps(document))
    return folder


def test_a_whole_video_has_the_frames_that_it_shows(tmp_path: Path) -> None:
    folder = film(tmp_path / "v", 7)
    views = load_sequence_views(folder, frames=7)
    assert len(views.views) == 14
    for frames in (6, 8):
        with pytest.raises(CaptureError, match=f"has 7 frames; expected {frames}, as the sequence"):
            load_sequence_views(folder, frames=frames)


def test_a_sequence_may_begin_in_the_midst_of_a_video(tmp_path: Path) -> None:
    folder = film(tmp_path / "v", 7)
    views = load_sequence_views(folder, frames=4, first=2)
    whole = load_sequence_views(folder, frames=7)
    assert np.array_equal(views.views["cam0", 1].read().colour, whole.views["cam0", 3].read().colour)
    with pytest.raises(CaptureError, match="has 7 frames; expected 8, as the sequence from 4 on"):
        load_sequence_views(folder, frames=4, first=4)


def test_masks_in_a_video_are_those_of_its_frames(tmp_path: Path) -> None:
    folder = film(tmp_path / "v", 7)
    (folder / "masks").mkdir()
    for name in ("cam0.avi", "cam1.avi"):
        path = str(folder / "masks" / name)
        writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 25, (SIZE, SIZE))
        for frame in range(7):
            mask = np.zeros((SIZE, SIZE, 3), np.uint8)
            mask[8 : 9 + frame, 8:20] = 255
            writer.write(mask)
        writer.release()
    views = load_sequence_views(folder, frames=4, first=2)
    heights = [(views.views["cam0", k].read().mask[:, 12] > 0.5).sum() for k in range(4)]
    assert heights == [3, 4, 5, 6]
    shutil.copyfile(film(tmp_path / "short", 5) / "cam0.avi", folder / "masks" / "cam1.avi")
    with pytest.raises(CaptureError, match="masks/cam1.avi: has 5 frames; expected 7, as its video"):
        load_sequence_views(folder, frames=4, first=2)


def test_frames_that_were_dropped_are_named(tmp_path: Path) -> None:
    video = Video(film(tmp_path / "v", 7) / "cam0.avi")
    assert np.allclose(np.diff(video.times), 0.04, atol=1e-3)
    video.check_steady()
    video.times = np.delete(video.times, 3)
    with pytest.raises(
        CaptureError, match="frame 3 is shown 80 ms after the one before it, where 40 ms are usual"
    ):
        video.check_steady()


def test_transforms_of_a_video_need_its_size(tmp_path: Path) -> None:
    folder = film(tmp_path / "v", 3)
    document = json.loads((folder / "transforms.json").read_text())
    del document["w"], document["h"]
    (folder / "transforms.json").write_text(json.dumps(document))
    with pytest.raises(CaptureError, match='"w" is missing'):
        read_transforms(folder / "transforms.json")


@pytest.mark.parametrize("splits", [("train",), ("train", "val", "test"), ("test",)])
def test_scenes_of_nerf_tell_their_cameras_by_split(splits: tuple[str, ...], tmp_path: Path) -> None:
    """One file a split, pictures of one name in the folders of all."""
    rest = Rest(tmp_path, [f"train/r_{k}.png" for k in range(COUNT)])
    colour, mask = picture()
    entries = rest.document["frames"]
    for number, split in enumerate(splits):
        (tmp_path / split).mkdir(exist_ok=True)
        frames = []
        for k in range(3):
            write_image(tmp_path / split / f"r_{k}.png", np.concatenate([colour, mask[..., None]], axis=2))
            matrix = entries[(2 * number + k) % COUNT]["transform_matrix"]
            frames.append({"file_path": f"./{split}/r_{k}", "rotation": 0.01, "transform_matrix": matrix})
        told = {"camera_angle_x": 0.5, "frames": frames}
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps(told))
    views = load_rest_views(tmp_path)
    assert len(views.read()) == 3 * len(splits)
    names = {f"{split}-r_{k}" if len(splits) > 1 else f"r_{k}" for split in splits for k in range(3)}
    assert set(views.views) == names
    # A transforms.json is the whole of it.
    whole = [entry | {"file_path": f"{splits[0]}/r_0", "camera": f"v{k}"} for k, entry in enumerate(entries)]
    rest.document["frames"] = whole
    assert list(load_rest_views(rest.write()).views) == [f"v{k}" for k in range(COUNT)]


def test_a_damaged_split_is_named(tmp_path: Path) -> None:
    (tmp_path / "transforms_train.json").write_text('{"frames": [')
    with pytest.raises(CaptureError, match="transforms_train.json"):
        load_rest_views(tmp_path)
