"""Pictures from image files and videos."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from mphygs.capture.errors import fault
from mphygs.capture.written import replace_file

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

    def read(self) -> Pixels:
        """The picture. Raises CaptureError where the file is no image."""
        try:
            data = np.frombuffer(self.path.read_bytes(), dtype=np.uint8)
        except OSError as error:
            raise fault(self.where, f"cannot be read ({error.strerror})", "an image") from error
        image = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if len(data) else None
        if image is None:
            raise fault(self.where, "is no image, or is damaged", "a PNG or JPEG")
        return _pixels(image, self.where)


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

    @property
    def frame_count(self) -> int:
        """Number of frames that the file says it has."""
        return int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))

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

    def read(self) -> Pixels:
        """The picture. Raises CaptureError where the video ends before it."""
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
