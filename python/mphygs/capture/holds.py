"""What holds, moves or pulls the object: held boxes with a rigid motion, known external forces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from mphygs.capture.document import Entry
from mphygs.capture.errors import fault
from mphygs.capture.files import Size, file_inside, read_arrays
from mphygs.capture.rotation import matrix_from_quaternion, sign_continuous

_WIDEST = 1e12  # [m] of a box, which may be wider than anything
_STRONGEST = 1e6  # [N]
_FASTEST = 0.5 * np.pi  # [rad] of a turn from one frame to the next


@dataclass(frozen=True, eq=False)
class Hold:
    """Material points in `box` at rest follow a rigid motion: X goes to R X + p.

    box: (2, 3) [m]; position: (T, 3) [m] and quaternion: (T, 4) (w, x, y, z), one pose a frame relative to
    rest and about the origin. Both are None for points that are fixed.
    """

    box: np.ndarray
    position: np.ndarray | None = None
    quaternion: np.ndarray | None = None

    @property
    def is_fixed(self) -> bool:
        """Whether the held points never move."""
        return self.position is None

    def poses(self, times: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
        """Rotations R (n, 3, 3) and translations p (n, 3) [m] at times (n,) [s], frame k being at k / fps.

        A cubic spline (not-a-knot) goes through the positions, another componentwise through the quaternions
        in one continuous choice of sign, renormalised. Before the first frame its value is held; after the
        last one both go on for one frame at the rate that they have there, and stay.
        """
        times = np.asarray(times, dtype=np.float64)
        if self.position is None or self.quaternion is None:
            return np.tile(np.eye(3), (len(times), 1, 1)), np.zeros((len(times), 3))
        values = np.concatenate([self.position, sign_continuous(self.quaternion)], axis=1)
        if len(values) == 1:
            at = np.repeat(values, len(times), axis=0)
        else:
            spline = CubicSpline(np.arange(len(values)), values)
            frame = np.clip(times * fps, 0, len(values))
            inside = np.minimum(frame, len(values) - 1)
            at = spline(inside) + (frame - inside)[:, None] * spline(len(values) - 1, 1)
        return matrix_from_quaternion(at[:, 3:]), at[:, :3]


@dataclass(frozen=True, eq=False)
class Load:
    """A known external force on the material points in `box`, from frame `start_frame` on.

    box: (2, 3) [m]; force: (3,) [N], shared by all the points together; end_frame: at which it is let go,
    None where it never is.
    """

    box: np.ndarray
    force: np.ndarray
    start_frame: int
    end_frame: int | None = None


def read_box(entry: Entry) -> np.ndarray:
    """A box (2, 3) [m]: its lower and its upper corner."""
    box = entry.array((2, 3), most=_WIDEST)
    if (box[0] > box[1]).any():
        axis = int(np.argmax(box[0] > box[1]))
        raise entry.fault(
            f"lower corner {box[0, axis]:g} above upper corner {box[1, axis]:g} along {'xyz'[axis]}",
            "[lower corner, upper corner]",
        )
    return box


def read_hold(folder: Path, entry: Entry, frames: int) -> Hold:
    """The hold that an element of `held` describes."""
    entry.check_keys(required=("box", "motion"))
    box = read_box(entry["box"])
    if entry["motion"].text() == "fixed":
        return Hold(box=box)
    path = file_inside(folder, entry["motion"])
    every = Size.frames(frames)
    arrays = read_arrays(path, {"position": (every, 3), "quaternion": (every, 4)})
    return Hold(box, *checked_poses(path, **arrays))


def checked_poses(
    path: Path, position: np.ndarray, quaternion: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Position (T, 3) [m] and quaternion (T, 4) of a file, of unit length. Raises CaptureError."""
    for name, array in (("position", position), ("quaternion", quaternion)):
        if np.isnan(array).any():
            frame = int(np.argwhere(np.isnan(array))[0, 0])
            raise fault(f"{path}: {name}", f"is NaN in frame {frame}", "the motion of a hold in every frame")
    length = np.linalg.norm(quaternion, axis=1)
    worst = int(np.argmax(np.abs(length - 1)))
    if abs(length[worst] - 1) > 1e-3:
        raise fault(
            f"{path}: quaternion", f"has length {length[worst]:.4g} in frame {worst}", "unit (w, x, y, z)"
        )
    turn = 2 * np.arccos(np.minimum(np.abs(np.einsum("tk,tk->t", quaternion[1:], quaternion[:-1])), 1.0))
    if len(turn) and turn.max() > _FASTEST:
        frame = int(np.argmax(turn)) + 1
        raise fault(
            f"{path}: quaternion",
            f"turns by {np.degrees(turn[frame - 1]):.0f} degrees to frame {frame}",
            f"at most {np.degrees(_FASTEST):.0f} from one frame to the next",
        )
    # those already of unit length keep their bits, so that a capture read and written is the same
    off = np.abs(length - 1) > 4e-16
    quaternion[off] /= length[off, None]
    return position, quaternion


def read_load(entry: Entry, frames: int) -> Load:
    """The load that an element of `loads` describes."""
    entry.check_keys(required=("box", "force", "from"), optional=("until",))
    start, end = read_frames(entry, frames)
    return Load(read_box(entry["box"]), entry["force"].array((3,), most=_STRONGEST), start, end)


def read_frames(entry: Entry, frames: int, default: int | None = None) -> tuple[int, int | None]:
    """The frames from and until which a load acts. default: where "from" is not given, None: it must be."""
    start, end = default, None
    if start is None or entry.get("from"):
        start = entry["from"].integer()
        if not 0 <= start < frames:
            raise entry["from"].wrong(f"a frame of the sequence, 0 to {frames - 1}")
    if given := entry.get("until"):
        end = given.integer()
        if not start < end <= frames:
            raise given.wrong(f'a frame after "from", {start + 1} to {frames}')
    return start, end
