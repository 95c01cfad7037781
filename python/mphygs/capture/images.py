"""Pictures from image files and videos."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from mphygs.capture.errors import fault
from mphygs.capture.picture_heads import PictureHead, picture_head
from mphygs.capture.written import replace_file

# Of a picture that nothing states the size of, and of any file.
_UNSTEADY = 0.5  # of the usual time between frames
MOST_PIXELS, _LARGEST_FILE = 50_000_000, 400_000_000
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
VIDEO_SUFFIXES = (".mp4", ".mov", ".avi", ".mkv", ".webm", ".m4v")


@dataclass(frozen=True, eq=False)
class Pixels:
    """colour: (H, W, 3) red, green, blue, 0 to 1, float32; alpha: (H, W), 0 to 1, None without it."""

    colour: np.ndarray
    alpha: np.ndarray | None


@dataclass(frozen=True)
class ImageFile:
    """A picture in a file of its own."""

    path: Path

    @property
    def where(self) -> str:
        """How messages name it."""
        return str(self.path)

    def size(self) -> tuple[int, int]:
        """Width and height [px], by the file's head. Raises CaptureError where it is no PNG or JPEG."""
        return self._head(self._content()).shown

    def read(self, size: tuple[int, int] | None = None, why: str = "") -> Pixels:
        """The picture. size: width and height that it must have [px], why: what says so; None for any.

        A picture with a mark of how to turn it is turned, unless it has the size as it is stored. Raises
        CaptureError where the file is no image, or of another size, before anything is unpacked.
        """
        data = self._content()
        head = self._head(data)
        stored = (head.width, head.height)
        if size is None:
            if math.prod(stored) > MOST_PIXELS:
                raise fault(self.where, f"is {_in_words(stored)}", f"at most {MOST_PIXELS} pixels")
        elif size not in (stored, head.shown):
            raise fault(self.where, f"is {_in_words(head.shown)}", f"{_in_words(size, '')}{why}")
        elif head.turn > 1 and stored == head.shown:
            what = f"is marked to be turned when shown (EXIF orientation {head.turn})"
            raise fault(self.where, what, "pixels as the camera has them, without that mark")
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
        if image is None or image.shape[1::-1] != stored:
            raise fault(self.where, "is no image, or is damaged", "a PNG or JPEG")
        return _pixels(image if size == stored else _turned(image, head.turn), self.where)

    def _content(self) -> bytes:
        try:
            if self.path.stat().st_size > _LARGEST_FILE:
                raise fault(self.where, f"has more than {_LARGEST_FILE} bytes", "a PNG or JPEG")
            return self.path.read_bytes()
        except OSError as error:
            raise fault(self.where, f"cannot be read ({error.strerror})", "an image") from error

    def _head(self, data: bytes) -> PictureHead:
        head = picture_head(data)
        if head is None or not (head.width and head.height):
            raise fault(self.where, "is no image, or is damaged", "a PNG or JPEG")
        return head


def _turned(image: np.ndarray, turn: int) -> np.ndarray:
    """Pixels as EXIF's mark says to show them."""
    if turn in (2, 4, 5, 7):
        image = image[:, ::-1]
    return np.rot90(image, {3: 2, 4: 2, 5: 1, 6: 3, 7: 3, 8: 1}.get(turn, 0))


def _in_words(size: tuple[int, int], unit: str = " pixels") -> str:
    return f"{size[0]} x {size[1]}{unit}"


def _pixels(image: np.ndarray, where: str) -> Pixels:
    """OpenCV's (H, W), (H, W, 3) or (H, W, 4) in blue, green, red order as Pixels."""
    if image.dtype not in (np.uint8, np.uint16):
        raise fault(where, f"holds {image.dtype}", "8 or 16 bits a channel")
    values = image.astype(np.float32) / np.float32(np.iinfo(image.dtype).max)
    if values.ndim == 2:
        return Pixels(np.repeat(values[..., None], 3, axis=2), None)
    return Pixels(np.ascontiguousarray(values[..., 2::-1]), values[..., 3] if values.shape[2] == 4 else None)


class Video:
    """A video file, fastest when its frames are read in order."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._capture = cv2.VideoCapture(str(path))
        self._next = 0
        if not self._capture.isOpened():
            raise fault(str(path), "is no video that can be read", f"one of {', '.join(VIDEO_SUFFIXES)}")

    @cached_property
    def times(self) -> np.ndarray:
        """(T,) when each frame is shown that can be decoded [s].

        Counted one by one: the head of a video that was cut without packing it again says more than it shows.
        """
        capture, times = cv2.VideoCapture(str(self.path)), []
        while capture.grab():
            times.append(1e-3 * capture.get(cv2.CAP_PROP_POS_MSEC))
        capture.release()
        return np.array(times)

    @property
    def frame_count(self) -> int:
        """Number of frames that can be decoded."""
        return len(self.times)

    def check_steady(self) -> None:
        """Raises CaptureError where frames do not follow one another at one rate."""
        apart = np.diff(self.times)
        usual = float(np.median(apart)) if len(apart) else 0.0
        if usual > 0 and np.abs(apart - usual).max() > _UNSTEADY * usual:
            frame = int(np.argmax(np.abs(apart - usual)))
            raise fault(
                str(self.path),
                f"frame {frame + 1} is shown {1e3 * apart[frame]:.0f} ms after the one before it, where "
                f"{1e3 * usual:.0f} ms are usual",
                "frames at one rate, none dropped",
            )

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of its pictures, by its head [px]."""
        sides = (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
        return tuple(int(self._capture.get(side)) for side in sides)

    def read(self, index: int) -> Pixels:
        """Frame `index`, counted from 0. Raises CaptureError where the video ends before it."""
        if index < self._next:
            # seeking is not exact with every codec; starting again is
            self._capture.release()
            self._capture = cv2.VideoCapture(str(self.path))
            self._next = 0
        image = None
        while self._next <= index:
            grabbed = self._capture.grab()
            if grabbed and self._next == index:
                grabbed, image = self._capture.retrieve()
            if not grabbed:
                raise fault(str(self.path), f"ends before frame {index}", f"at least {index + 1} frames")
            self._next += 1
        return _pixels(image, str(self.path))


@dataclass(frozen=True, eq=False)
class VideoFrame:
    """One picture of a video."""

    video: Video
    index: int

    @property
    def where(self) -> str:
        """How messages name it."""
        return f"{self.video.path}: frame {self.index}"

    def read(self, size: tuple[int, int] | None = None, why: str = "") -> Pixels:
        """The picture; size, why: as of an image. Raises CaptureError where the video ends before it."""
        if size is not None and self.video.size != size:
            raise fault(self.where, f"is {_in_words(self.video.size)}", f"{_in_words(size, '')}{why}")
        return self.video.read(self.index)


Source = ImageFile | VideoFrame


def write_image(path: Path, values: np.ndarray) -> None:
    """Write (H, W), (H, W, 3) or (H, W, 4) values, 0 to 1, red, green, blue, alpha, as an 8-bit image.

    Raises OSError where it cannot be written.
    """
    scaled = np.round(255 * np.clip(values, 0, 1)).astype(np.uint8)
    if scaled.ndim == 3:
        scaled = scaled[..., [2, 1, 0, 3][: scaled.shape[2]]]
    encoded, data = cv2.imencode(path.suffix, scaled)
    if not encoded:
        raise OSError(f"{path}: cannot be encoded as an image")
    replace_file(path, data.tobytes())
