"""Folders of views: dense pictures of the object at rest, and synchronised videos of its motion."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mphygs.capture.annotations import Correspondence
from mphygs.capture.cameras import Camera
from mphygs.capture.checks import SIZE
from mphygs.capture.distortion import undistort_image, undistorted
from mphygs.capture.errors import fault
from mphygs.capture.images import Source
from mphygs.capture.masks import check_masks, checked_mask, mask_of_picture, mask_of_plate


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
