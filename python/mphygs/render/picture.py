"""What a camera sees of a set of Gaussians."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from mphygs.capture.cameras import Camera
from mphygs.scene.gaussians import Gaussians

if TYPE_CHECKING:
    from torch import Tensor

COLOUR_AND_DEPTH = 4  # channels before the features


@dataclass(frozen=True, eq=False)
class Optics:
    """How Gaussians are drawn. nearest: those with less depth are not drawn [m]; blur: added to the
    projected covariance, about one pixel's own width [px^2] (0.3 in 3DGS)."""

    nearest: float = 0.01
    blur: float = 0.3


@dataclass(frozen=True, eq=False)
class Picture:
    """Sums over Gaussians, each weighted by what is seen of it.

    colour: (H, W, 3), over the background; opacity: (H, W), 0 to 1, the sum of the weights; depth: (H, W)
    [m], not divided by opacity; features: (H, W, F); visible: indices of the Gaussians that reach the
    picture, nearest first.
    """

    colour: Tensor
    opacity: Tensor
    depth: Tensor
    features: Tensor
    visible: Tensor

    def mean_depth(self, least_opacity: float = 1e-3) -> Tensor:
        """Depth (H, W) [m] of what is seen; NaN where the opacity is below least_opacity."""
        seen = self.opacity >= least_opacity
        mean = self.depth / self.opacity.where(seen, 1.0)
        return mean.where(seen, float("nan"))


def picture_of(image: Tensor, transmittance: Tensor, visible: Tensor, background: Tensor | None) -> Picture:
    """A picture from channels (4 + F, H, W): red, green, blue, depth, features; transmittance (H, W)."""
    pixels = image.permute(1, 2, 0)
    colour = pixels[..., :3]
    if background is not None:
        colour = colour + transmittance[..., None] * background
    return Picture(colour, 1.0 - transmittance, pixels[..., 3], pixels[..., COLOUR_AND_DEPTH:], visible)


def checked_background(background: Tensor | None, camera: Camera) -> None:
    """Raise ValueError unless `background` is None, (3,) or (H, W, 3)."""
    shapes = ((3,), (camera.height, camera.width, 3))
    if background is not None and tuple(background.shape) not in shapes:
        have = tuple(background.shape)
        raise ValueError(f"background: has shape {have}; expected {shapes[0]} or {shapes[1]}")


def checked_screen_offsets(screen_offsets: Tensor | None, gaussians: Gaussians) -> None:
    """Raise ValueError unless `screen_offsets` is None or (N, 2)."""
    if screen_offsets is not None and tuple(screen_offsets.shape) != (gaussians.count, 2):
        have = tuple(screen_offsets.shape)
        raise ValueError(f"screen_offsets: have shape {have}; expected {(gaussians.count, 2)}")
