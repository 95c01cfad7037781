"""Folders of views, found and checked: which pictures, videos, masks and plates belong together."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from mphygs.capture.annotations import read_contact, read_correspondences
from mphygs.capture.cameras import Camera
from mphygs.capture.errors import fault
from mphygs.capture.images import IMAGE_SUFFIXES, VIDEO_SUFFIXES, ImageFile, Source, Video, VideoFrame
from mphygs.capture.layouts import named_apart, read_shots
from mphygs.capture.record import Capture, Sequence
from mphygs.capture.shots import Shot
from mphygs.capture.views import RestViews, SequenceViews, View

LEAST_REST_VIEWS = 3
LEAST_CAMERAS = 2


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
