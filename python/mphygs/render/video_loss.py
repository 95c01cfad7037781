"""How unlike one frame of the videos the Gaussians are: the paper's L_2D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from mphygs.capture.cameras import Camera
from mphygs.capture.views import Photograph
from mphygs.render.distance_maps import distance_loss, distance_map
from mphygs.render.image_losses import feature_loss, image_loss
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians


@dataclass(frozen=True)
class VideoWeights:
    """Of the three parts of L_2D, the paper's; 0 leaves a part out."""

    colour: float = 0.1
    features: float = 0.1
    distance: float = 1e-3

    def __post_init__(self) -> None:
        if min(self.colour, self.features, self.distance) < 0:
            raise ValueError(f"{self}: expected no weight below zero")


@dataclass(frozen=True, eq=False)
class FrameObservation:
    """What one camera saw of one frame. colour: (H, W, 3) over black; features: (h, w, F), or None,
    times the share of the object in each of its pixels; distances: (H, W) [px] from the silhouette."""

    camera: Camera
    colour: Tensor
    distances: Tensor
    features: Tensor | None


@dataclass(frozen=True, eq=False)
class VideoLoss:
    """total: weighted sum of colour (L_rgb), features (L_DINO) and distance (L_DT) [px], means over views."""

    total: Tensor
    colour: Tensor
    features: Tensor
    distance: Tensor


def observation_of(photograph: Photograph, features: Tensor | None = None) -> FrameObservation:
    """What is compared with a photograph. features: (h, w, F), at most as fine as it."""
    mask = torch.from_numpy(photograph.mask)
    if features is not None:
        weight = torch.nn.functional.adaptive_avg_pool2d(mask[None], features.shape[:2])[0]
        features = features.to(torch.float32) * weight[..., None]
    return FrameObservation(
        camera=photograph.camera,
        colour=torch.from_numpy(photograph.colour) * mask[..., None],
        distances=distance_map(photograph.mask),
        features=features,
    )


def video_loss(
    gaussians: Gaussians,
    observations: Sequence[FrameObservation],
    *,
    weights: VideoWeights = VideoWeights(),  # noqa: B008 (frozen)
    scales: int = 3,
    threads: int | None = None,
) -> VideoLoss:
    """L_2D = 0.1 L_rgb + 0.1 L_DINO + 1e-3 L_DT of Gaussians against one frame, mean over its views.

    L_rgb: L1 and D-SSIM at `scales` resolutions; L_DINO: L1 of feature maps at as many, over black, nothing
    where the observations hold none; L_DT: distance of the projected centres from the silhouettes [px].
    Raises ValueError where there are no observations, or features of another number of channels.
    """
    if not observations:
        raise ValueError("observations: are none; expected one a camera")
    zero = gaussians.positions.new_zeros(())
    colour, features = [], []
    for observation in observations:
        if weights.colour == 0 and weights.features == 0:
            break
        picture = splat(gaussians, observation.camera, threads=threads)
        colour.append(image_loss(picture.colour, observation.colour, scales=scales))
        if observation.features is not None and weights.features > 0:
            features.append(feature_loss(picture.features, observation.features, scales=scales))
    distance = zero
    if weights.distance > 0:
        cameras = [observation.camera for observation in observations]
        maps = [observation.distances for observation in observations]
        distance = distance_loss(gaussians.positions, cameras, maps)
    mean_colour = torch.stack(colour).mean() if colour else zero
    mean_features = torch.stack(features).mean() if features else zero
    total = weights.colour * mean_colour + weights.features * mean_features + weights.distance * distance
    return VideoLoss(total, mean_colour, mean_features, distance)
