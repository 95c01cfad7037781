"""Pictures from files and videos; masks from all three sources."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mphygs.capture.errors import CaptureError
from mphygs.capture.images import ImageFile, Video, VideoFrame, write_image
from mphygs.capture.masks import checked_mask, mask_of_plate


def test_written_images_come_back(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 4)) / 255.0
    write_image(tmp_path / "a.png", image)
    pixels = ImageFile(tmp_path / "a.png").read()
    np.testing.assert_allclose(pixels.colour, image[..., :3], atol=1e-6)
    np.testing.assert_allclose(pixels.alpha, image[..., 3], atol=1e-6)
    write_image(tmp_path / "b.png", image[..., :3])
    assert ImageFile(tmp_path / "b.png").read().alpha is None
    write_image(tmp_path / "c.png", image[..., 0])
    np.testing.assert_allclose(ImageFile(tmp_path / "c.png").read().colour[..., 2], image[..., 0], atol=1e-6)
    cv2.imwrite(str(tmp_path / "d.png"), np.full((2, 2, 3), 65535, np.uint16))
    assert (ImageFile(tmp_path / "d.png").read().colour == 1).all()


@pytest.mark.parametrize("content", [b"", b"no image", b"\x89PNG\r\n\x1a\n"])
def test_files_that_are_no_images(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(CaptureError, match=r"a.png: is no image, or is damaged; expected a PNG or JPEG"):
        ImageFile(tmp_path / "a.png").read()
    with pytest.raises(CaptureError, match="cannot be read"):
        ImageFile(tmp_path / "b.png").read()


def write_video(path: Path, frames: int) -> None:
    """Grey frames whose brightness is 20 times their number."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10, (32, 16))
    assert writer.isOpened()
    for frame in range(frames):
        writer.write(np.full((16, 32, 3), (20 * frame, 20 * frame, 250), np.uint8))
    writer.release()


def test_frames_of_a_video_in_any_order(tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi", 6)
    video = Video(tmp_path / "a.avi")
    assert video.frame_count == 6
    for index in (0, 1, 4, 5, 2, 2, 3, 0):
        colour = VideoFrame(video, index).read().colour
        assert colour.shape == (16, 32, 3)
        np.testing.assert_allclose(colour[8, 8], [250 / 255, 20 * index / 255, 20 * index / 255], atol=0.02)
    with pytest.raises(CaptureError, match="ends before frame 6"):
        video.read(6)
    assert video.read(1).colour[0, 0, 1] < 0.12


def test_a_file_that_is_no_video(tmp_path: Path) -> None:
    (tmp_path / "a.avi").write_bytes(b"nothing")
    with pytest.raises(CaptureError, match="is no video that can be read"):
        Video(tmp_path / "a.avi")


def test_mask_from_a_picture_of_the_background() -> None:
    draw = np.random.default_rng(0)
    plate = draw.uniform(0.2, 0.5, (40, 50, 3))
    colour = plate.copy()
    colour[10:30, 15:40] = [0.9, 0.8, 0.1]
    colour = np.clip(colour + draw.normal(0, 0.01, colour.shape), 0, 1)
    noisy = np.clip(plate + draw.normal(0, 0.01, colour.shape), 0, 1)
    mask = mask_of_plate(colour.astype(np.float32), noisy.astype(np.float32))
    truth = np.zeros((40, 50))
    truth[10:30, 15:40] = 1
    assert ((mask > 0.5) & (truth > 0.5)).sum() / ((mask > 0.5) | (truth > 0.5)).sum() > 0.85
    assert not mask_of_plate(noisy.astype(np.float32), plate.astype(np.float32)).any()


def test_masks_that_are_refused() -> None:
    mask = np.zeros((4, 6), np.float32)
    with pytest.raises(CaptureError, match="the mask is empty; expected white"):
        checked_mask(mask, "m.png")
    mask[2, 3] = 1
    assert checked_mask(mask, "m.png") is mask
