"""Cameras, and the one place where the conventions of axes and pixels are written down.

A camera's own axes are OpenCV's: x right, y down, z forward, in metres. World axes are the object frame of
the capture. Pixel coordinates are (u, v) = (right, down) from the corner of the picture, so that the centre
of its first pixel is at (0.5, 0.5), as in COLMAP and nerfstudio; OpenCV's own functions put it at (0, 0) and
are called half a pixel off. nerfstudio's axes are OpenGL's: y up and z backward.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

# from OpenGL's axes of a camera to OpenCV's, and back
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
MOST_PIXELS = 10**8  # of a picture
DISTORTIONS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
FISHEYE = ("k1", "k2", "k3", "k4", "p1", "p2", "sx1", "sy1")


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective camera.

    width, height: [px]; focal: (2,) [px]; centre: (2,), where the axis meets the picture [px];
    camera_from_world: (4, 4), rotation and translation [m]; distortion: (8,), OpenCV's rational model in its
    order k1 k2 p1 p2 k3 k4 k5 k6 [1], zero without lens distortion; fisheye: (8,), k1 k2 k3 k4 p1 p2 sx1 sy1
    of a lens that is one [1] (capture/fisheye.py), None for others.
    Raises ValueError, one line, for numbers that are no camera.
    """

    name: str
    width: int
    height: int
    focal: np.ndarray
    centre: np.ndarray
    camera_from_world: np.ndarray
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(len(DISTORTIONS)))
    fisheye: np.ndarray | None = None

    def __post_init__(self) -> None:
        count = len(DISTORTIONS)
        shapes = {"focal": (2,), "centre": (2,), "camera_from_world": (4, 4), "distortion": (count,)}
        if self.fisheye is not None:
            shapes["fisheye"] = (len(FISHEYE),)
        for name, shape in shapes.items():
            array = np.array(getattr(self, name), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise ValueError(f'camera "{self.name}": {name} is not {shape} finite numbers')
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if self.width < 1 or self.height < 1:
            size = f"{self.width} x {self.height}"
            raise ValueError(f'camera "{self.name}": its picture is {size} pixels; expected at least 1 x 1')
        if self.width * self.height > MOST_PIXELS:
            size = f"{self.width} x {self.height}"
            raise ValueError(f'camera "{self.name}": its picture is {size} pixels; expected at most 1e8')
        if not (self.focal > 0).all():
            raise ValueError(f'camera "{self.name}": focal lengths {self.focal} px; expected above 0')
        rotation, last = self.camera_from_world[:3, :3], self.camera_from_world[3]
        off = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
        if off > 1e-3 or np.linalg.det(rotation) < 0 or np.abs(last - [0, 0, 0, 1]).max() > 1e-9:
            raise ValueError(
                f'camera "{self.name}": its pose is no rigid motion (rotation off by {off:.2g}, '
                f"determinant {np.linalg.det(rotation):.3g}, last row {last.tolist()}); "
                "expected a rotation, a translation and the last row 0 0 0 1"
            )

    @property
    def world_from_camera(self) -> np.ndarray:
        """The inverse of camera_from_world, (4, 4)."""
        rotation, translation = self.camera_from_world[:3, :3], self.camera_from_world[:3, 3]
        inverse = np.eye(4)
        inverse[:3, :3] = rotation.T
        inverse[:3, 3] = -rotation.T @ translation
        return inverse

    @property
    def position(self) -> np.ndarray:
        """Where the camera stands in the world, (3,) [m]."""
        return self.world_from_camera[:3, 3]

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (N, 2) [px], lens distortion undone, and depths (N,) [m] of world points (N, 3) [m].

        Points that are not in front of the camera get NaN pixels.
        """
        own = points @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        depth = own[:, 2]
        ratio = own[:, :2] / np.where(depth > 0, depth, np.nan)[:, None]
        return ratio * self.focal + self.centre, depth

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Unit world directions (..., 3) of sight through undistorted pixels (..., 2) [px]."""
        ratio = (np.asarray(pixels, dtype=np.float64) - self.centre) / self.focal
        own = np.concatenate([ratio, np.ones_like(ratio[..., :1])], axis=-1)
        direction = own @ self.camera_from_world[:3, :3]
        return direction / np.linalg.norm(direction, axis=-1, keepdims=True)

    def resized(self, width: int, height: int) -> Camera:
        """The same camera with a picture of width x height pixels."""
        ratio = np.array([width / self.width, height / self.height])
        return replace(self, width=width, height=height, focal=self.focal * ratio, centre=self.centre * ratio)


def camera_from_world_of_opengl(world_from_camera: np.ndarray) -> np.ndarray:
    """camera_from_world (4, 4), OpenCV's axes, of a camera-to-world matrix (4, 4) in OpenGL's."""
    return np.linalg.inv(np.asarray(world_from_camera, dtype=np.float64) @ _FLIP)


def opengl_of_camera(camera: Camera) -> np.ndarray:
    """The camera-to-world matrix (4, 4) in OpenGL's axes, as nerfstudio writes it."""
    return camera.world_from_camera @ _FLIP


def looking_at(
    position: np.ndarray, target: np.ndarray, up: tuple[float, float, float] = (0.0, 0.0, 1.0)
) -> np.ndarray:
    """camera_from_world (4, 4) of a camera at `position` (3,) [m] that sees `target` (3,) [m] in its middle.

    Raises ValueError where position, target and up do not fix a camera.
    """
    forward = np.asarray(target, dtype=np.float64) - position
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-9 * max(float(np.linalg.norm(forward)), 1e-300):
        raise ValueError("the line of sight is along up; expected another direction")
    forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ position
    return pose
