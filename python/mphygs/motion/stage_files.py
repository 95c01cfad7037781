"""What the stages that follow an object through videos hand on, read and checked.

Every file may be the user's own: what does not fit ends in one line that says what, where and what was
expected.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.errors import fault
from mphygs.capture.files import Size, read_arrays
from mphygs.capture.holds import Hold, checked_poses
from mphygs.capture.rotation import matrix_from_quaternion


@dataclass(frozen=True, eq=False)
class Registered:
    """The object in frame 0. quaternion: (4,) wxyz and position: (3,) [m]: x = R X + p of the whole from
    rest; refined: (K, 3) [m], places of the Gaussians."""

    quaternion: np.ndarray
    position: np.ndarray
    refined: np.ndarray

    @property
    def rotation(self) -> np.ndarray:
        """R, (3, 3)."""
        return matrix_from_quaternion(self.quaternion)


@dataclass(frozen=True, eq=False)
class Tracks:
    """M points in T frames. rest: (M, 3) [m]; position: (T, M, 3) [m], NaN where not seen; sigma: (M,) [m],
    standard deviation a coordinate."""

    rest: np.ndarray
    position: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True, eq=False)
class GaussianTracks(Tracks):
    """Tracks of Gaussians. quaternion: (T, M, 4), from rest, NaN where not seen; gaussian: (M,), rows of
    gaussians.ply."""

    quaternion: np.ndarray
    gaussian: np.ndarray

    def arrays(self) -> dict[str, np.ndarray]:
        """As they are written; places in single precision, which is finer than a thousandth of sigma."""
        small = {name: getattr(self, name).astype(np.float32) for name in ("position", "quaternion")}
        return {"rest": self.rest, "sigma": self.sigma, "gaussian": self.gaussian, **small}


def read_registered(path: Path, *, gaussians: int) -> Registered:
    """pose.npz. Raises CaptureError, one line, for another number of Gaussians and what is no pose."""
    points = Size(gaussians, "points", "as gaussians.ply")
    arrays = read_arrays(path, {"quaternion": (4,), "position": (3,), "refined": (points, 3)})
    _check_numbers(path, "refined", arrays["refined"])
    (position,), (quaternion,) = checked_poses(path, arrays["position"][None], arrays["quaternion"][None])
    return Registered(quaternion, position, arrays["refined"])


def read_tracks(path: Path, *, frames: int) -> Tracks:
    """tracks.npz, one sigma for all or one for each. Raises CaptureError, one line, for other frames than the
    sequence's, shapes that do not fit together, and a sigma that is not above zero."""
    shapes = {"rest": (None, 3), "position": (Size.frames(frames), None, 3), "sigma": None}
    arrays = read_arrays(path, shapes, others=True)
    rest, position, sigma = (arrays[name] for name in shapes)
    if position.shape[1] != len(rest):
        raise fault(f"{path}: position", f"has {position.shape[1]} tracks", f"{len(rest)}, as rest")
    if sigma.shape not in ((), (len(rest),)):
        raise fault(f"{path}: sigma", f"has shape {sigma.shape}", f"one number or {len(rest)}, as rest")
    _check_numbers(path, "rest", rest)
    if not (sigma > 0).all():
        raise fault(f"{path}: sigma", f"is {sigma.min():g}", "standard deviations above 0 m")
    return Tracks(rest, position, np.broadcast_to(sigma, (len(rest),)).copy())


def read_stage_hold(path: Path, *, frames: int) -> Hold:
    """hold.npz. Raises CaptureError, one line, for other frames than the sequence's and what is no pose."""
    every = Size.frames(frames)
    shapes = {"position": (every, 3), "quaternion": (every, 4), "box": (2, 3)}
    arrays = read_arrays(path, shapes, others=True)
    box = arrays["box"]
    if not (box[0] <= box[1]).all():
        raise fault(f"{path}: box", f"is {box.tolist()}", "[lower corner, upper corner]")
    return Hold(box, *checked_poses(path, arrays["position"], arrays["quaternion"]))


def _check_numbers(path: Path, name: str, array: np.ndarray) -> None:
    if np.isnan(array).any():
        raise fault(f"{path}: {name}", f"is NaN at {np.argwhere(np.isnan(array))[0].tolist()}", "numbers")
