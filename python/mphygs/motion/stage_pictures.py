"""Pictures to look at: registration, tracks over the video, the path of the contact."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import torch
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from mphygs.capture.holds import Hold
from mphygs.capture.images import write_image
from mphygs.capture.rotation import matrix_from_quaternion, rotation_vector_from_quaternion
from mphygs.capture.views import Photograph
from mphygs.capture.written import replace_file
from mphygs.motion.stage_files import Tracks
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians

_TALL = 320  # pixels of a cell
_SHIFT = 4  # binary places of a pixel in which OpenCV draws
_TRAIL = 8  # frames of a track that are drawn behind it
_DRAWN = 500  # tracks
_FRAMES = 5  # of the video
_CAMERAS = 3
_DIM = 0.55  # of the video under the tracks


def write_register_picture(
    path: Path, photographs: Sequence[Photograph], before: Gaussians, after: Gaussians
) -> None:
    """One row a camera: the photograph, the Gaussians at rest, registered, and four times the difference."""
    rows = []
    for photograph in photographs[:_CAMERAS]:
        seen = photograph.colour * photograph.mask[..., None]
        with torch.no_grad():
            drawn = [splat(g, photograph.camera).colour.numpy() for g in (before, after)]
        rows.append([seen, *drawn, 4.0 * np.abs(seen - drawn[1])])
    write_image(path, _table(rows, window_of(photographs[:_CAMERAS])))


def write_track_picture(path: Path, frames: dict[int, Sequence[Photograph]], tracks: Tracks) -> None:
    """One row a camera, one column a frame of `frames`: tracks where they are, with what they came along.

    Colours tell the tracks apart, by where they are at rest.
    """
    chosen = np.arange(len(tracks.rest))[:: max(1, len(tracks.rest) // _DRAWN)]
    colours = _colours(tracks.rest)[chosen]
    cameras = [p.camera for p in next(iter(frames.values()))][:_CAMERAS]
    rows = []
    for row in range(len(cameras)):
        cells = []
        for frame, photographs in frames.items():
            photograph = photographs[row]
            cell = np.ascontiguousarray(_DIM * photograph.colour * photograph.mask[..., None])
            factor = max(1, -(-2 * _TALL // cell.shape[0]))
            cell = cv2.resize(cell, None, fx=factor, fy=factor, interpolation=cv2.INTER_LINEAR)
            for k, colour in zip(chosen, colours, strict=True):
                path_of = tracks.position[max(0, frame - _TRAIL) : frame + 1, k]
                if not np.isfinite(path_of[-1]).all():
                    continue
                pixels = photograph.camera.project(path_of[np.isfinite(path_of).all(axis=1)])[0]
                if not np.isfinite(pixels).all():
                    continue
                corners = np.round((pixels * factor - 0.5) * 2**_SHIFT).astype(np.int32)
                cv2.polylines(cell, [corners[:, None]], False, colour.tolist(), 1, cv2.LINE_AA, _SHIFT)
                cv2.circle(cell, corners[-1].tolist(), 2**_SHIFT, colour.tolist(), -1, cv2.LINE_AA, _SHIFT)
            cells.append(cell)
        rows.append(cells)
    seen = [photographs[row] for photographs in frames.values() for row in range(len(cameras))]
    write_image(path, _table(rows, window_of(seen)))


def frames_shown(frames: int) -> list[int]:
    """Frames of a sequence that the picture of its tracks shows."""
    return np.unique(np.linspace(0, frames - 1, _FRAMES).astype(int)).tolist()


def write_contact_picture(
    path: Path, hold: Hold, fps: float, at: np.ndarray | None, coarse: np.ndarray | None
) -> None:
    """The place of the contact and its turn over time.

    at: (3,) [m], the contact at rest, None for the middle of the box; coarse: (T, 3) [m], triangulated, NaN
    where nobody pointed at it, None for nowhere.
    """
    at = hold.box.mean(axis=0) if at is None else at
    place = matrix_from_quaternion(hold.quaternion) @ at + hold.position
    turn = np.degrees(rotation_vector_from_quaternion(hold.quaternion))
    seconds = np.arange(len(place)) / fps
    figure = Figure(figsize=(9.0, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True)
    for axis, (name, colour) in enumerate(zip("xyz", ("#d1495b", "#4a7c59", "#2e5eaa"), strict=True)):
        above.plot(seconds, 1e3 * (place[:, axis] - at[axis]), color=colour, label=name)
        if coarse is not None:
            above.plot(seconds, 1e3 * (coarse[:, axis] - at[axis]), ".", color=colour, alpha=0.6)
        below.plot(seconds, turn[:, axis], color=colour, label=name)
    above.set_ylabel("contact against rest [mm]")
    below.set_ylabel("turn, rotation vector [degrees]")
    below.set_xlabel("time [s]")
    above.legend(title="dots: pointed at" if coarse is not None else None, loc="upper left")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    replace_file(path, buffer.getvalue())


def window_of(photographs: Sequence[Photograph]) -> tuple[float, float, float, float]:
    """Shares (top, bottom, left, right) of the pictures outside of which none shows the object."""
    edges = []
    for photograph in photographs:
        row, column = np.nonzero(photograph.mask >= 0.5 * photograph.mask.max())
        height, width = photograph.mask.shape
        edges.append((row.min() / height, row.max() / height, column.min() / width, column.max() / width))
    top, bottom, left, right = np.array(edges).T
    low, high = np.array([top.min(), left.min()]) - 0.04, np.array([bottom.max(), right.max()]) + 0.04
    (top, left), (bottom, right) = np.maximum(low, 0.0), np.minimum(high, 1.0)
    return float(top), float(bottom), float(left), float(right)


def _table(rows: Sequence[Sequence[np.ndarray]], window: tuple[float, float, float, float]) -> np.ndarray:
    """Pictures (H, W, 3) cut to a window and put side by side, every cell as tall."""
    top, bottom, left, right = window
    lines = []
    for row in rows:
        cells = []
        for cell in row:
            height, width = cell.shape[:2]
            cut = cell[int(top * height) : int(np.ceil(bottom * height)) + 1]
            cut = cut[:, int(left * width) : int(np.ceil(right * width)) + 1]
            size = (max(1, round(cut.shape[1] * _TALL / cut.shape[0])), _TALL)
            shape = cv2.INTER_AREA if cut.shape[0] > _TALL else cv2.INTER_LINEAR
            cells.append(cv2.resize(np.clip(cut, 0.0, 1.0).astype(np.float32), size, interpolation=shape))
        lines.append(np.concatenate(cells, axis=1))
    widest = max(line.shape[1] for line in lines)
    return np.concatenate([np.pad(line, ((0, 0), (0, widest - line.shape[1]), (0, 0))) for line in lines])


def _colours(rest: np.ndarray) -> np.ndarray:
    """Bright colours (M, 3), 0 to 1, of points (M, 3) that change with their place."""
    share = (rest - rest.min(axis=0)) / np.maximum(np.ptp(rest, axis=0), 1e-9)
    hue = (share @ [1.7, 2.3, 0.9]) % 1.0
    bright = np.stack([np.float32(360.0 * hue), np.full(len(rest), 0.9), np.ones(len(rest))], axis=1)
    return cv2.cvtColor(bright[None].astype(np.float32), cv2.COLOR_HSV2RGB)[0]
