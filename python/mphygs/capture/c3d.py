"""Points of a .c3d motion capture file, in metres."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import ezc3d
import numpy as np

from mphygs.capture.errors import fault, one_line

_METRES = {"m": 1.0, "dm": 1e-1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}


def read_c3d(path: Path, *, fps: float, frames: int, first: int = 0) -> tuple[np.ndarray, tuple[str, ...]]:
    """`frames` frames (T, M, 3) [m] from `first` on, NaN where a point was not seen, and the M labels.

    Raises CaptureError when the file is damaged or truncated, has another rate than `fps`, no unit of length,
    or fewer frames.
    """
    try:
        content = ezc3d.c3d(str(path))
    except (RuntimeError, OSError, ValueError, IndexError, MemoryError, OverflowError) as error:
        reason = str(error) or type(error).__name__
        raise fault(str(path), f"cannot be read, or is truncated ({reason})", "a .c3d file") from error
    points = content["data"]["points"]
    count = points.shape[2]
    declared = _declared_frames(path)
    if count < declared:
        raise fault(str(path), f"is truncated: {count} frames of {declared}", "the whole file")
    if count < first + frames:
        expected = f"at least {first + frames}, as the sequence"
        raise fault(f"{path}: POINT", f"has {count} frames", expected)
    if points.shape[1] == 0:
        raise fault(f"{path}: POINT", "has no points", "measured markers")
    group = content["parameters"]["POINT"]
    rate = float(content["header"]["points"]["frame_rate"])
    if abs(rate - fps) > 1e-3 * fps:
        raise fault(f"{path}: POINT:RATE", f"is {rate:g} Hz", f"the fps of the sequence, {fps:g}")
    units = group["UNITS"]["value"] if "UNITS" in group else []
    unit = units[0].strip().lower() if len(units) else ""
    if unit not in _METRES:
        raise fault(f"{path}: POINT:UNITS", f'is "{unit}"', f"one of {', '.join(_METRES)}")
    position = np.moveaxis(points[:3], 0, -1).swapaxes(0, 1).astype(np.float64) * _METRES[unit]
    # points of negative residual, which were not seen, come from ezc3d as NaN
    position = position[first : first + frames]
    if np.isinf(position).any():
        frame, marker, _ = (int(i) for i in np.argwhere(np.isinf(position))[0])
        raise fault(f"{path}: POINT", f"is infinite in frame {frame}, point {marker}", "finite positions")
    labels = list(group["LABELS"]["value"]) if "LABELS" in group else []
    return position, tuple(one_line(label) for label in labels[: points.shape[1]])


def _declared_frames(path: Path) -> int:
    """How many frames the file's own header promises; ezc3d puts there what it could read instead.

    Words 4 and 5 of the header are the first and the last frame, in the byte order of the processor that
    the parameter section names (86: big-endian). Recordings of more than 65535 frames
    promise fewer than they have.
    """
    with path.open("rb") as stream:
        head = stream.read(10)
        stream.seek(512 * (head[0] - 1) + 3)
        order: Literal["big", "little"] = "big" if stream.read(1) == bytes([86]) else "little"
    return int.from_bytes(head[8:10], order) - int.from_bytes(head[6:8], order) + 1
