"""Rendered prediction beside the video: errors of pictures over ranges of frames, and a film of both."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np

from mphygs.capture.views import Photograph
from mphygs.render.image_metrics import ImageMetrics, image_metrics, mean_metrics
from mphygs.render.picture import Picture

# Views that a film shows, one under the other.
FILMED = 2


@dataclass(frozen=True, eq=False)
class ComparedFrame:
    """One frame: what is predicted for each camera, and what it saw."""

    frame: int
    pictures: Sequence[Picture]
    photographs: Sequence[Photograph]


def frame_metrics(shown: ComparedFrame) -> ImageMetrics:
    """Mean over the cameras of one frame."""
    pairs = zip(shown.pictures, shown.photographs, strict=True)
    return mean_metrics(image_metrics(picture, photograph) for picture, photograph in pairs)


def range_errors(
    metrics: Mapping[int, ImageMetrics], fit: tuple[int, int], predict: tuple[int, int]
) -> dict[str, dict[str, float] | None]:
    """ "fit", "predict", "all" -> psnr [dB], iou, chamfer_px, means over frames; None without a frame.

    metrics: by frame; fit, predict: ranges of frames, of which a frame fitted counts as fitted only.
    """
    fitted = {frame for frame in metrics if fit[0] <= frame < fit[1]}
    unseen = {frame for frame in metrics if predict[0] <= frame < predict[1]} - fitted
    chosen = {"fit": fitted, "predict": unseen, "all": fitted | unseen}
    return {
        label: asdict(mean_metrics(metrics[frame] for frame in sorted(frames))) if frames else None
        for label, frames in chosen.items()
    }


class Film:
    """A video file of measured pictures at the left and predicted ones at the right. Use as a context."""

    def __init__(self, path: Path, fps: float) -> None:
        self.path, self.fps = path, fps
        self._writer: cv2.VideoWriter | None = None

    def __enter__(self) -> Film:
        return self

    def __exit__(self, failed: object, *_: object) -> None:
        if self._writer is None:
            return
        self._writer.release()
        if failed is None:
            os.replace(self._part, self.path)
        self._part.unlink(missing_ok=True)

    @property
    def _part(self) -> Path:
        """Where it is written, until it is whole."""
        return self.path.with_name(f".part-{os.getpid()}-{self.path.name}")

    def add(self, shown: ComparedFrame) -> None:
        """One frame more. Raises OSError where no video can be written."""
        rows = [
            np.concatenate([p.colour * p.mask[..., None], picture.colour.detach().numpy()], axis=1)
            for picture, p in list(zip(shown.pictures, shown.photographs, strict=True))[:FILMED]
        ]
        width = max(row.shape[1] for row in rows)
        padded = [np.pad(row, ((0, 0), (0, width - row.shape[1]), (0, 0))) for row in rows]
        image = np.round(255 * np.clip(np.concatenate(padded), 0, 1)).astype(np.uint8)[..., ::-1]
        # codecs want even sizes
        image = np.pad(image, ((0, image.shape[0] % 2), (0, image.shape[1] % 2), (0, 0)))
        if self._writer is None:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            code = cv2.VideoWriter_fourcc(*"mp4v")
            self._writer = cv2.VideoWriter(str(self._part), code, self.fps, image.shape[1::-1])
            if not self._writer.isOpened():
                raise OSError(errno.EIO, "no video can be written there", str(self.path))
        self._writer.write(np.ascontiguousarray(image))


def image_table(sequences: Mapping[str, Mapping[str, Mapping[str, float] | None]]) -> list[list[str]]:
    """Rows of cells for people: sequence, frames, PSNR, IoU, chamfer distance. The first row is the head."""
    rows = [["sequence", "frames", "PSNR dB", "IoU %", "chamfer px"]]
    for name, ranges in sequences.items():
        for label in ("fit", "predict", "all"):
            error = ranges.get(label)
            if error is not None and "psnr" in error:
                cells = (f"{error['psnr']:.2f}", f"{100 * error['iou']:.1f}", f"{error['chamfer_px']:.2f}")
                rows.append([name, label, *cells])
    return rows


def joined_errors(
    points: Mapping[str, Mapping[str, Mapping[str, object] | None]],
    images: Mapping[str, Mapping[str, Mapping[str, float] | None]],
) -> dict[str, dict[str, dict[str, object] | None]]:
    """Errors of points and of pictures in one, by sequence and range; what was not measured is None."""
    empty = {"rms": None, "max": None, "rms_over_sigma": None, "count": 0}
    out: dict[str, dict[str, dict[str, object] | None]] = {}
    for name in dict.fromkeys((*points, *images)):
        out[name] = {}
        for label in ("fit", "predict", "all"):
            point, image = (found.get(name, {}).get(label) for found in (points, images))
            both = None if point is None and image is None else {**(point or empty), **(image or {})}
            out[name][label] = both
    return out


def frames_of(ranges: Iterable[tuple[int, int]]) -> list[int]:
    """Frames of ranges [a, b), in order, each once."""
    return sorted({frame for first, last in ranges for frame in range(first, last)})
