"""Cameras from a nerfstudio transforms.json, and back."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mphygs.capture.cameras import (
    DISTORTIONS,
    FISHEYE,
    Camera,
    camera_from_world_of_opengl,
    opengl_of_camera,
)
from mphygs.capture.document import Entry, read_document
from mphygs.capture.errors import CaptureError, fault
from mphygs.capture.files import file_inside
from mphygs.capture.images import IMAGE_SUFFIXES, ImageFile
from mphygs.capture.shots import Shot
from mphygs.capture.written import replace_file

_INTRINSICS = (
    "fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "k2", "k3", "k4", "p1", "p2", "camera_angle_x",
    "camera_angle_y", "camera_model", "is_fisheye",
)  # fmt: skip
# what nerfstudio, instant-ngp, Polycam, Blender and their converters write beside that, of no meaning here
_NOTES = (
    "enable_depth_loading", "integer_depth_scale", "from_na", "fix_premult", "white_transparent",
    "black_transparent", "sharpen", "n_extra_learnable_dims", "render_aabb", "up", "n_frames", "time",
    "aabb_scale", "scale", "offset", "applied_transform", "applied_scale", "ply_file_path",
    "orientation_override", "auto_scale_poses_override", "train_filenames", "val_filenames", "test_filenames",
)  # fmt: skip
_FRAME_NOTES = (
    "colmap_im_id", "sharpness", "depth_file_path", "rotation", "time", "timestamp", "blur_score",
    "manual_keyframe", "neighbors",
)  # fmt: skip
_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL")
_FISHEYES = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")


def read_transforms(path: Path) -> list[Shot]:
    """The pictures of the transforms.json at `path`, in its order.

    Intrinsics stand in a frame or once for all; `transform_matrix` is camera-to-world in OpenGL's axes [m];
    `camera` and `frame` name the camera and the frame of a sequence; a frame without `camera` is a camera of
    its own, named as its file. Raises CaptureError for anything that cannot be used.
    """
    root = read_document(path)
    root.check_keys(required=("frames",), optional=(*_INTRINSICS, *_NOTES))
    frames = root["frames"].elements()
    if not frames:
        raise root["frames"].fault("is empty", "at least one picture")
    return [_read_frame(path.parent, root, frame) for frame in frames]


def _read_frame(folder: Path, root: Entry, entry: Entry) -> Shot:
    entry.check_keys(
        required=("file_path", "transform_matrix"),
        optional=(*_INTRINSICS, *_FRAME_NOTES, "camera", "frame", "mask_path"),
    )
    image = _image_inside(folder, entry["file_path"])
    given = entry.get("mask_path")
    mask = file_inside(folder, given) if given else None
    name = entry["camera"].text() if entry.get("camera") else image.stem
    frame: int | None = None
    if number := entry.get("frame"):
        frame = number.integer()
        if frame < 0:
            raise number.wrong("a frame, counted from 0")
    matrix = entry["transform_matrix"].array((4, 4))
    if abs(np.linalg.det(matrix)) < 1e-9:
        raise entry["transform_matrix"].fault("is singular", "a rigid camera-to-world matrix")
    size, focal, centre = _read_intrinsics(root, entry, image)
    distortion, fisheye = _read_lens(root, entry)
    try:
        pose = camera_from_world_of_opengl(matrix)
        camera = Camera(name, *size, focal, centre, pose, distortion, fisheye)
    except ValueError as error:
        raise fault(entry.where, str(error), "a camera of nerfstudio's convention") from error
    return Shot(camera=camera, image=image, mask=mask, frame=frame, where=entry.where)


def _image_inside(folder: Path, entry: Entry) -> Path:
    """The file of a picture; Blender names it without its ending."""
    text = entry.text()
    for suffix in ("", *IMAGE_SUFFIXES):
        named = replace(entry, value=text + suffix)
        try:
            return file_inside(folder, named)
        except CaptureError:
            continue
    return file_inside(folder, entry)


def _read_intrinsics(
    root: Entry, entry: Entry, image: Path
) -> tuple[tuple[int, int], np.ndarray, np.ndarray]:
    """Size, focal lengths and principal point, of the frame or else of the document; the size that neither
    tells is that of the picture."""

    def find(key: str) -> Entry | None:
        return entry.get(key) or root.get(key)

    def number(key: str) -> float | None:
        found = find(key)
        return None if found is None else found.number()

    size = []
    if find("w") is None and find("h") is None and image.suffix.lower() in IMAGE_SUFFIXES:
        size = list(ImageFile(image).size())
    for key in () if size else ("w", "h"):
        found = find(key)
        if found is None:
            raise entry.fault(f'"{key}" is missing', "the size of the picture, here or for all frames")
        value = found.number()
        if value != int(value) or value < 1:
            raise found.wrong("a whole number of pixels above zero")
        size.append(int(value))
    focal_x, focal_y = number("fl_x"), number("fl_y")
    if focal_x is None:
        angle = find("camera_angle_x")
        if angle is None:
            raise entry.fault('"fl_x" is missing', "the focal length [px], here or for all frames")
        if not 0 < angle.number() < math.pi:
            raise angle.wrong("an angle of view above 0 and below pi [rad]")
        focal_x = 0.5 * size[0] / math.tan(0.5 * angle.number())
    centre = [number("cx"), number("cy")]
    centre = [0.5 * side if at is None else at for at, side in zip(centre, size, strict=True)]
    focal = np.array([focal_x, focal_x if focal_y is None else focal_y])
    return (size[0], size[1]), focal, np.array(centre)


def _read_lens(root: Entry, entry: Entry) -> tuple[np.ndarray, np.ndarray | None]:
    """Distortion (8,), and that of a fisheye (8,), None where it is none, of the frame or else of the
    document."""

    def given(key: str) -> Entry | None:
        return entry.get(key) or root.get(key)

    def refuse(keys: tuple[str, ...], expected: str) -> None:
        for key in keys:
            if (found := given(key)) is not None and found.number() != 0:
                raise found.wrong(f"0: {expected}")

    def numbers(keys: tuple[str, ...]) -> np.ndarray:
        found = [given(key) if key in _INTRINSICS else None for key in keys]
        return np.array([0.0 if one is None else one.number() for one in found])

    model, flag = given("camera_model"), given("is_fisheye")
    if model is not None and model.value not in (*_MODELS, *_FISHEYES):
        raise model.wrong(f"one of {', '.join((*_MODELS, *_FISHEYES))}")
    fisheye = flag is not None and flag.flag()
    if fisheye or (model is not None and model.value in _FISHEYES):
        refuse(("p1", "p2"), "distortion of a fisheye is k1, k2, k3, k4")
        return np.zeros(len(DISTORTIONS)), numbers(FISHEYE)
    # nerfstudio's k4 is a fourth power, OpenCV's divides
    refuse(("k4",), "lens distortion is k1, k2, k3, p1, p2")
    return numbers(DISTORTIONS), None


def write_transforms(
    path: Path, cameras: Sequence[Camera], files: Sequence[str], frames: Sequence[int | None]
) -> None:
    """Write pictures `files`, relative to `path`, of `cameras` as a transforms.json that can be read again.

    frames: index of each picture in its sequence, None for rest views. Raises ValueError for a camera whose
    distortion the format cannot hold (k4 to k6, of a fisheye p1 to sy1).
    """
    entries = []
    for camera, file, frame in zip(cameras, files, frames, strict=True):
        if camera.distortion[5:].any() or (camera.fisheye is not None and camera.fisheye[4:].any()):
            raise ValueError(f'camera "{camera.name}": its distortion has no place in transforms.json')
        lens = dict(zip(DISTORTIONS[:5], camera.distortion[:5].tolist(), strict=True))
        if camera.fisheye is not None:
            lens = {"camera_model": "OPENCV_FISHEYE"}
            lens |= dict(zip(FISHEYE[:4], camera.fisheye[:4].tolist(), strict=True))
        entry: dict[str, object] = {
            "file_path": file,
            "camera": camera.name,
            "w": camera.width,
            "h": camera.height,
            "fl_x": camera.focal[0],
            "fl_y": camera.focal[1],
            "cx": camera.centre[0],
            "cy": camera.centre[1],
            **lens,
            "transform_matrix": opengl_of_camera(camera).tolist(),
        }
        entries.append(entry if frame is None else entry | {"frame": frame})
    replace_file(path, json.dumps({"camera_model": "OPENCV", "frames": entries}, indent=1) + "\n")
