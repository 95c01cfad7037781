"""Folders of views: dense pictures of the object at rest, and synchronised videos of its motion."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mphygs.capture.annotations import Correspondence, read_contact, read_correspondences
from mphygs.capture.cameras import Camera
from mphygs.capture.checks import SIZE
from mphygs.capture.distortion import undistort_image, undistorted
from mphygs.capture.errors import fault
from mphygs.capture.images import IMAGE_SUFFIXES, VIDEO_SUFFIXES, ImageFile, Source, Video, VideoFrame
from mphygs.capture.layouts import named_apart, read_shots
from mphygs.capture.masks import check_masks, checked_mask, mask_of_picture, mask_of_plate
from mphygs.capture.record import Capture, Sequence
from mphygs.capture.shots import Shot

LEAST_REST_VIEWS = 3
LEAST_CAMERAS = 2


@dataclass(frozen=True, eq=False)
class Photograph:
    """A picture with lens distortion undone.

    camera: without distortion; colour: (H, W, 3), 0 to 1, float32; mask: (H, W), 1 for the object, float32.
    """

    camera: Camera
    colour: np.ndarray
    mask: np.ndarray

    def within(self, longest: int) -> Photograph:
        """The picture at a half, a third, ... of its size, so that no side is longer than `longest` [px]."""
        return self.shrunk(max(1, -(-max(self.camera.width, self.camera.height) // longest)))

    def shrunk(self, factor: int) -> Photograph:
        """The picture `factor` times smaller along each side, by the mean over its pixels."""
        if factor == 1:
            return self
        camera = self.camera.resized(
            max(self.camera.width // factor, 1), max(self.camera.height // factor, 1)
        )
        size = (camera.width, camera.height)
        colour, mask = (
            cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in (self.colour, self.mask)
        )
        return Photograph(camera, colour, mask)


@dataclass(frozen=True, eq=False)
class View:
    """One picture, not read yet. camera: as given, with distortion; mask, plate: None where there is none."""

    camera: Camera
    source: Source
    mask: Source | None
    plate: Source | None

    def read(self) -> Photograph:
        """The picture and its mask, lens distortion undone.

        The mask is the given one; without it the picture's alpha channel; without that the difference from
        the plate, a picture of the background alone. Raises CaptureError where a file cannot be read, is of
        another size than the camera, or shows nothing of the object.
        """
        size = (self.camera.width, self.camera.height)
        pixels = self.source.read(size, f", as camera {self.camera.name} says")
        where = self.source.where
        if self.mask is not None:
            mask, where = mask_of_picture(self.mask.read(size, ", as its picture")), self.mask.where
        elif pixels.alpha is not None:
            mask = pixels.alpha
        elif self.plate is not None:
            mask = mask_of_plate(pixels.colour, self.plate.read(size, ", the size of its pictures").colour)
        else:
            raise fault(
                where,
                "nothing says where the object is in it",
                "a mask in masks/, an alpha channel, or a picture of the background in background/",
            )
        mask = undistort_image(self.camera, checked_mask(mask, where))
        if not (mask >= 0.5).any():
            what = f"nothing of the object is left once the lens distortion of {self.camera.name} is undone"
            raise fault(where, what, "distortion as small as a lens has it")
        colour = undistort_image(self.camera, pixels.colour)
        return Photograph(undistorted(self.camera), colour, mask)


def check_extent(where: str, photographs: list[Photograph]) -> None:
    """Raises CaptureError where the object would be as large as none is: the cameras stand in another unit.

    Its place is where the lines of sight through the middles of the masks meet best.
    """
    places, ways, across = [], [], []
    for p in photographs:
        row, column = np.nonzero(p.mask >= 0.5)
        middle = np.array([column.mean() + 0.5, row.mean() + 0.5])
        places.append(p.camera.position)
        ways.append(p.camera.rays(middle))
        across.append(max(np.ptp(row), np.ptp(column), 1) / p.camera.focal.mean())
    place, way = np.array(places), np.array(ways)
    aside = np.eye(3) - way[:, :, None] * way[:, None]
    met, rank = np.linalg.lstsq(aside.sum(axis=0), np.einsum("nij,nj->i", aside, place), rcond=1e-6)[::2]
    if rank < 3:  # all look the same way
        return
    size = float(np.median(np.linalg.norm(place - met, axis=1) * across))
    if not SIZE[0] <= size <= SIZE[1]:
        factor = 1e-3 if size > SIZE[1] else 1e3
        fits = SIZE[0] <= size * factor <= SIZE[1]
        hint = f"; units look off by 1000: set scale to {factor:g} times its value" if fits else ""
        what = f"by its cameras the object is {size:.3g} m across"
        raise fault(where, what, f"{SIZE[0]:g} to {SIZE[1]:g} m{hint}")


@dataclass(frozen=True, eq=False)
class RestViews:
    """Dense views of the object at rest, by name in the order of the file."""

    views: dict[str, View]

    def read(self) -> list[Photograph]:
        """All pictures. Raises CaptureError where masks look inverted, or the object has no sensible size."""
        photographs = [view.read() for view in self.views.values()]
        first = next(iter(self.views.values()))
        check_masks((first.mask or first.source).where, [p.mask for p in photographs])
        check_extent(first.source.where, photographs)
        return photographs


@dataclass(frozen=True, eq=False)
class SequenceViews:
    """Synchronised videos. views: (camera, frame) -> view, every camera with every frame.

    contact: camera -> frame -> pixel (2,) [px], annotated; correspondences: points seen at rest and in frame
    0, annotated. Both in undistorted pixels.
    """

    cameras: tuple[str, ...]
    frames: int
    views: dict[tuple[str, int], View]
    contact: dict[str, dict[int, np.ndarray]]
    correspondences: tuple[Correspondence, ...]

    def read(self, frame: int) -> list[Photograph]:
        """The pictures of all cameras at `frame`, in the order of `cameras`."""
        return [self.views[name, frame].read() for name in self.cameras]


def load_rest_views(folder: Path, *, scale: float = 1.0) -> RestViews:
    """The dense rest views in `folder`; pictures are read when asked for, the first at once as a check.

    scale: metres per unit of the reconstruction. Raises CaptureError, one line, for cameras or files that
    cannot be used, and for fewer than three views.
    """
    shots = named_apart(folder, read_shots(folder, scale))
    views: dict[str, View] = {}
    for shot in shots:
        name = shot.camera.name
        if name in views:
            raise fault(shot.where, f'view "{name}" is given twice', "one picture a view")
        if shot.image.suffix.lower() in VIDEO_SUFFIXES:
            raise fault(shot.where, f"{shot.image} is a video", "one image a view of the object at rest")
        views[name] = _view(folder, shot, ImageFile(shot.image))
    if len(views) < LEAST_REST_VIEWS:
        raise fault(
            str(folder), f"has {len(views)} views", f"at least {LEAST_REST_VIEWS} of the object at rest"
        )
    next(iter(views.values())).read()
    return RestViews(views)


def load_sequence_views(
    folder: Path,
    *,
    frames: int,
    rest: RestViews | None = None,
    first: int | None = None,
    scale: float = 1.0,
) -> SequenceViews:
    """The videos in `folder` of a sequence of `frames` frames; the first picture of each camera is read.

    An entry that names a video and no frame stands for all frames of that camera. rest: needed where there is
    a correspondences.json; first: of a whole video, the frame that is frame 0, and it may be longer; scale:
    metres per unit of the reconstruction. Raises CaptureError, one line: a camera or a frame that is missing
    or given twice, files that cannot be used, fewer than two cameras.
    """
    views: dict[tuple[str, int], View] = {}
    videos: dict[Path, Video] = {}
    for shot in read_shots(folder, scale):
        for frame, source in _frames_of(shot, frames, videos, first):
            key = (shot.camera.name, frame)
            if key in views:
                raise fault(
                    shot.where, f'frame {frame} of camera "{key[0]}" is given twice', "every frame once"
                )
            if frame >= frames:
                raise fault(shot.where, f"is frame {frame}", f"a frame of the sequence, 0 to {frames - 1}")
            views[key] = _view(folder, shot, source, videos)
    cameras = tuple(dict.fromkeys(name for name, _ in views))
    if len(cameras) < LEAST_CAMERAS:
        raise fault(
            str(folder), f"has {len(cameras)} camera", f"at least {LEAST_CAMERAS} that saw the motion"
        )
    for name in cameras:
        missing = [frame for frame in range(frames) if (name, frame) not in views]
        if missing:
            more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
            raise fault(
                str(folder),
                f'camera "{name}" has no frame {missing[0]}{more}',
                f"frames 0 to {frames - 1} of every camera, in step",
            )
        _check_sizes(folder, [views[name, frame].camera for frame in range(frames)])
        views[name, 0].read()
    at = {key: view.camera for key, view in views.items()}
    contact, correspondences = folder / "contact.json", folder / "correspondences.json"
    if correspondences.is_file() and rest is None:
        raise fault(str(correspondences), "speaks of rest views, of which there are none", "object.views")
    at_rest = {} if rest is None else {name: view.camera for name, view in rest.views.items()}
    return SequenceViews(
        cameras=cameras,
        frames=frames,
        views=views,
        contact=read_contact(contact, at) if contact.is_file() else {},
        correspondences=read_correspondences(correspondences, at_rest, at)
        if correspondences.is_file()
        else (),
    )


def rest_views_of(capture: Capture) -> RestViews:
    """The dense rest views of a capture. Raises CaptureError where it has none or they cannot be used."""
    if capture.views is None:
        raise fault(str(capture.folder / "capture.json"), "has no dense rest views", "object.views")
    return load_rest_views(capture.views, scale=capture.views_scale)


def sequence_views_of(sequence: Sequence, rest: RestViews | None = None) -> SequenceViews:
    """The videos of a capture's sequence. Raises CaptureError where it has none or they cannot be used."""
    if sequence.views is None:
        raise fault(f'sequence "{sequence.name}"', "has no views", "measured video")
    return load_sequence_views(
        sequence.views,
        frames=sequence.frames,
        rest=rest,
        first=sequence.first_frame,
        scale=sequence.views_scale,
    )


def _frames_of(
    shot: Shot, frames: int, videos: dict[Path, Video], first: int | None
) -> Iterable[tuple[int, Source]]:
    """The frames of a sequence that a shot stands for."""
    if shot.image.suffix.lower() not in VIDEO_SUFFIXES:
        if shot.frame is None:
            raise fault(shot.where, "says not which frame it is", '"camera" and "frame" for each picture')
        return [(shot.frame, ImageFile(shot.image))]
    video = _opened(shot.image, videos)
    if shot.frame is not None:
        return [(shot.frame, VideoFrame(video, shot.frame))]
    count, begin = video.frame_count, first or 0
    if count < begin + frames or (first is None and count > frames):
        more = f", as the sequence from {begin} on" if begin else ", as the sequence"
        raise fault(str(shot.image), f"has {count} frames", f"{begin + frames}{more}")
    video.check_steady()
    return [(frame, VideoFrame(video, begin + frame)) for frame in range(frames)]


def _opened(path: Path, videos: dict[Path, Video]) -> Video:
    """The video at `path`, opened once."""
    if path not in videos:
        videos[path] = Video(path)
    return videos[path]


def _view(folder: Path, shot: Shot, source: Source, videos: dict[Path, Video] | None = None) -> View:
    mask = shot.mask or _beside(folder, shot.image, "masks")
    found: Source | None = None
    if mask is not None and mask.suffix.lower() in VIDEO_SUFFIXES and isinstance(source, VideoFrame):
        found = _masked(source, _opened(mask, {} if videos is None else videos))
    elif mask is not None:
        found = ImageFile(mask)
    elif (folder / "masks").is_dir():
        raise fault(str(folder / "masks"), f"has no mask for {shot.image.name}", "one of the same name")
    plates = [folder / "background" / f"{shot.camera.name}{suffix}" for suffix in IMAGE_SUFFIXES]
    plate = next((ImageFile(path) for path in plates if path.is_file()), None)
    return View(camera=shot.camera, source=source, mask=found, plate=plate)


def _masked(source: VideoFrame, mask: Video) -> VideoFrame:
    """The frame of a video of masks that belongs to one of its video. Raises CaptureError for one that is
    longer or shorter."""
    if mask.frame_count != source.video.frame_count:
        expected = f"{source.video.frame_count}, as its video"
        raise fault(str(mask.path), f"has {mask.frame_count} frames", expected)
    return VideoFrame(mask, source.index)


def _beside(folder: Path, image: Path, kind: str) -> Path | None:
    """The file for `image` (images/x.jpg) in the folder `kind` beside images/: x.jpg, or x.png."""
    try:
        inside = image.relative_to(folder / "images")
    except ValueError:
        inside = Path(image.name)
    mask = folder / kind / inside
    for path in (mask, *(mask.with_suffix(suffix) for suffix in IMAGE_SUFFIXES)):
        if path.is_file():
            return path
    return None


def _check_sizes(folder: Path, cameras: list[Camera]) -> None:
    sizes = {(camera.width, camera.height) for camera in cameras}
    if len(sizes) > 1:
        written = " and ".join(f"{width} x {height}" for width, height in sorted(sizes))
        raise fault(str(folder), f'camera "{cameras[0].name}" has pictures of {written} pixels', "one size")
