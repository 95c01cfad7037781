"""The files that the stages of an image capture hand on, read and checked.

Every file may be the user's own: what does not fit ends in one line that says what, where and what was
expected.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from mphygs.capture.errors import fault
from mphygs.capture.files import Size, read_arrays
from mphygs.scene.object_files import read_particles
from mphygs.scene.soft_boundary import Particles

# Beyond this share of its length a quaternion is no rotation.
_UNIT = 1e-3


@dataclass(frozen=True)
class StageFolder:
    """Where the stages of one image capture stand."""

    folder: Path

    @property
    def gaussians(self) -> Path:
        """The object at rest as Gaussians."""
        return self.folder / "rest" / "gaussians.ply"

    @property
    def features(self) -> Path:
        """What the Gaussians look like beyond colour."""
        return self.folder / "features" / "features.npz"

    @property
    def particles(self) -> Path:
        """The object's volume as particles."""
        return self.folder / "object" / "particles.npz"

    @property
    def parts(self) -> Path:
        """Folder of the segments' meshes."""
        return self.folder / "object" / "parts"

    def pose(self, sequence: str) -> Path:
        """Where a sequence begins."""
        return self.folder / "register" / sequence / "pose.npz"

    def tracks(self, sequence: str) -> Path:
        """Points followed through a sequence."""
        return self.folder / "track" / sequence / "tracks.npz"

    def hold(self, sequence: str) -> Path:
        """What moves the object in a sequence."""
        return self.folder / "contact" / sequence / "hold.npz"


@dataclass(frozen=True, eq=False)
class Tracks:
    """Points followed through a sequence. rest: (M, 3) [m]; position: (T, M, 3) [m], NaN where not seen;
    sigma: (M,) standard deviation of a coordinate [m]."""

    rest: np.ndarray
    position: np.ndarray
    sigma: np.ndarray


def particles_of(folder: Path, segments: int) -> Particles:
    """The particles of a folder of stages. Raises CaptureError where they name other segments than these."""
    path = StageFolder(folder).particles
    particles = read_particles(path)
    if particles.segment_count > segments:
        found = f"names {particles.segment_count} segments"
        raise fault(f"{path}: label", found, f"at most {segments}, one for each mesh of a part")
    if not particles.inside.any():
        raise fault(f"{path}: signed_distance", "is above zero everywhere", "particles inside the object")
    return particles


def read_tracks(path: Path, *, frames: int) -> Tracks:
    """Tracks of a sequence of so many frames. Raises CaptureError."""
    shapes = {"rest": (None, 3), "position": (Size.frames(frames), None, 3), "sigma": None}
    arrays = read_arrays(path, shapes, others=True)
    rest, position, sigma = _finite(path, "rest", arrays["rest"]), arrays["position"], arrays["sigma"]
    if position.shape[1] != len(rest):
        raise fault(f"{path}: position", f"has {position.shape[1]} tracks", f"{len(rest)}, as rest")
    if sigma.shape not in ((), (len(rest),)) or not np.all(sigma > 0) or not np.isfinite(sigma).all():
        raise fault(
            f"{path}: sigma", "is no standard deviation", f"one number or {len(rest)}, above zero [m]"
        )
    return Tracks(rest, position, np.broadcast_to(sigma, (len(rest),)).copy())


def read_motion(path: Path, *, frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Box (2, 3) at rest [m], position (T, 3) [m], unit quaternion (T, 4) of a hold. Raises CaptureError."""
    every = Size.frames(frames)
    shapes = {"position": (every, 3), "quaternion": (every, 4), "box": (2, 3)}
    arrays = read_arrays(path, shapes, others=True)
    box, position, quaternion = (_finite(path, n, arrays[n]) for n in ("box", "position", "quaternion"))
    length = np.linalg.norm(quaternion, axis=1)
    if np.abs(length - 1).max() > _UNIT:
        frame = int(np.abs(length - 1).argmax())
        raise fault(
            f"{path}: quaternion", f"has length {length[frame]:.4g} in frame {frame}", "unit (w, x, y, z)"
        )
    if (box[0] > box[1]).any():
        raise fault(
            f"{path}: box", "has its lower corner above its upper one", "[lower corner, upper corner]"
        )
    return box, position, quaternion / length[:, None]


def _finite(path: Path, name: str, values: np.ndarray) -> np.ndarray:
    if not np.isfinite(values).all():
        raise fault(
            f"{path}: {name}", f"is not finite in row {np.argwhere(~np.isfinite(values))[0, 0]}", "numbers"
        )
    return values
