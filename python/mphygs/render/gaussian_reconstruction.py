"""Gaussians of the object at rest from dense views with masks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from mphygs.capture.colmap import ColmapPoints
from mphygs.capture.errors import fault
from mphygs.capture.view_folders import LEAST_REST_VIEWS
from mphygs.capture.views import Photograph
from mphygs.render.density_control import DensityControl, DensityRule
from mphygs.render.image_losses import feature_loss, image_loss
from mphygs.render.image_metrics import ImageMetrics, image_metrics
from mphygs.render.lifting import gathered
from mphygs.render.raw_gaussians import RawGaussians
from mphygs.render.splatting import splat
from mphygs.scene.first_gaussians import first_points, gaussians_at, mean_features
from mphygs.scene.gaussians import Gaussians

Progress = Callable[[int, int, float, int], None]
_REPORT = 10  # iterations
_LEAST_SEEN = 0.03  # [px] of a Gaussian, in the mean over views


@dataclass(frozen=True)
class ReconstructionSettings:
    """iterations: one view each; degree: of the colour's harmonics, 0 (Lambertian) to 3; hull: voxels along
    the longest side of the hull that gives the first points; change_every: iterations between changes of
    density, in the share `grow_until` of all also growth; mask_weight, feature_weight: of the L1 of opacity
    and of features beside the colour's loss; position_rate: of the object's extent, falling to
    last_position_rate; the other rates are those of 3DGS, twice the scales' and rotations'.
    """

    iterations: int = 1500
    degree: int = 0
    hull: int = 64
    change_every: int = 100
    grow_until: float = 0.6
    mask_weight: float = 0.5
    feature_weight: float = 0.1
    position_rate: float = 1e-3
    last_position_rate: float = 1e-5
    rotation_rate: float = 2e-3
    scale_rate: float = 1e-2
    opacity_rate: float = 0.05
    colour_rate: float = 0.01
    feature_rate: float = 0.01
    seed: int = 0
    density: DensityRule = field(default_factory=DensityRule)

    def __post_init__(self) -> None:
        if self.iterations < 1 or self.change_every < 1 or not 0 <= self.degree <= 3:
            raise ValueError(
                f"iterations {self.iterations}, change_every {self.change_every}, degree {self.degree}; "
                "expected at least 1, at least 1, and 0 to 3"
            )


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """gaussians: float32; losses: (iterations,); metrics: view -> how well it is explained at the end."""

    gaussians: Gaussians
    losses: np.ndarray
    metrics: dict[str, ImageMetrics]


def reconstruct(
    photographs: Sequence[Photograph],
    *,
    feature_maps: Sequence[Tensor] | None = None,
    colmap: ColmapPoints | None = None,
    settings: ReconstructionSettings | None = None,
    progress: Progress | None = None,
) -> Reconstruction:
    """Gaussians that look like the object in every photograph, and are nothing outside its masks.

    feature_maps: (h, w, F) a photograph, at most as fine as it, which the Gaussians' features then explain;
    colmap: points to begin with, else the visual hull; progress: called with (iteration, iterations, loss,
    Gaussians). Colours are compared over black, opacity with the mask. The same numbers for the same seed.
    Raises CaptureError for too few photographs, and where masks and cameras cannot belong together.
    """
    settings = ReconstructionSettings() if settings is None else settings
    maps = _checked(photographs, feature_maps)
    positions, colours = first_points(photographs, colmap, resolution=settings.hull)
    features = mean_features(photographs, maps, positions) if maps else np.zeros((len(positions), 0))
    raw = RawGaussians(gaussians_at(positions, colours, features))
    extent = float(np.linalg.norm(np.ptp(positions, axis=0)))
    control = DensityControl(settings.density, extent=extent, count=raw.count, seed=settings.seed)
    masks = [torch.from_numpy(photograph.mask) for photograph in photographs]
    targets = [
        torch.from_numpy(p.colour) * mask[..., None] for p, mask in zip(photographs, masks, strict=True)
    ]

    draw = np.random.default_rng(settings.seed)
    order: list[int] = []
    losses = np.zeros(settings.iterations)
    degree_steps = [round(settings.iterations * 0.2 * (k + 1)) for k in range(settings.degree)]
    for iteration in range(settings.iterations):
        if iteration in degree_steps:
            raw.raise_degree()
        if not order:
            order = draw.permutation(len(photographs)).tolist()
        view = order.pop()
        camera, mask = photographs[view].camera, masks[view]
        offsets = torch.zeros(raw.count, 2, requires_grad=True)
        picture = splat(raw.gaussians(), camera, screen_offsets=offsets)
        loss = image_loss(picture.colour, targets[view])
        loss = loss + settings.mask_weight * (picture.opacity - mask).abs().mean()
        if maps:
            weight = _shrunk(mask, maps[view])
            wanted = maps[view] * weight[..., None]
            loss = loss + settings.feature_weight * feature_loss(picture.features, wanted, scales=1)
        loss.backward()
        losses[iteration] = loss.item()
        if offsets.grad is not None:
            control.add(offsets.grad, picture.visible, max(camera.width, camera.height))
        raw.step(_rates(settings, extent, iteration))
        done = iteration + 1
        if done % settings.change_every == 0 and done < settings.iterations:
            control.change(raw, grow=done <= settings.grow_until * settings.iterations)
        if progress is not None and (done % _REPORT == 0 or done == settings.iterations):
            progress(
                done, settings.iterations, float(losses[max(0, done - _REPORT) : done].mean()), raw.count
            )
    gaussians = _seen(raw.gaussians().each(torch.Tensor.detach), photographs)
    metrics = {p.camera.name: image_metrics(splat(gaussians, p.camera), p) for p in photographs}
    return Reconstruction(gaussians, losses, metrics)


def _checked(photographs: Sequence[Photograph], feature_maps: Sequence[Tensor] | None) -> list[Tensor]:
    if len(photographs) < LEAST_REST_VIEWS:
        raise fault("rest views", f"are {len(photographs)}", f"at least {LEAST_REST_VIEWS}")
    if feature_maps is None:
        return []
    if len(feature_maps) != len(photographs) or len({values.shape[2:] for values in feature_maps}) != 1:
        raise ValueError(f"{len(feature_maps)} feature maps; expected (h, w, F) for each photograph, one F")
    return [values.to(torch.float32) for values in feature_maps]


def _shrunk(mask: Tensor, values: Tensor) -> Tensor:
    """The mask (H, W) at the resolution (h, w) of a feature map."""
    return torch.nn.functional.adaptive_avg_pool2d(mask[None], values.shape[:2])[0]


def _seen(gaussians: Gaussians, photographs: Sequence[Photograph]) -> Gaussians:
    """The Gaussians of which the views see anything: nothing says where the others belong."""
    amount = torch.zeros(gaussians.count)
    for photograph in photographs:
        camera = photograph.camera
        amount += gathered(gaussians, camera, torch.ones(camera.height, camera.width, 1))[:, 0]
    kept = amount >= _LEAST_SEEN * len(photographs)
    return gaussians.each(lambda tensor: tensor[kept])


def _rates(settings: ReconstructionSettings, extent: float, iteration: int) -> dict[str, float]:
    share = iteration / max(settings.iterations - 1, 1)
    falling = settings.position_rate ** (1 - share) * settings.last_position_rate**share
    return {
        "positions": falling * extent,
        "rotations": settings.rotation_rate,
        "log_scales": settings.scale_rate,
        "logit_opacities": settings.opacity_rate,
        "constant": settings.colour_rate,
        "harmonics": settings.colour_rate / 20,
        "features": settings.feature_rate,
    }
