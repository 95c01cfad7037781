"""What pictures say at every pixel, given to the Gaussians that are seen there.

A feature is rendered exactly like colour: at pixel p it is sum_k w_pk z_k, w_pk what is seen of Gaussian k.
So the map from features z (K, F) to pictures is linear, and its transpose is what backward computes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy import sparse
from scipy.spatial import cKDTree
from torch import Tensor

from mphygs.capture.cameras import Camera
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians

Report = Callable[[float, str], None]
_CHANNELS = 32  # rendered together
_LEAST_SEEN = 1e-3  # [px] of a Gaussian in all views, below which it takes its neighbours' feature


@dataclass(frozen=True, eq=False)
class SeenMap:
    """A map of one view. camera: of the map's own resolution; values: (h, w, F); weight: (h, w), how much a
    cell counts, 0 outside the object."""

    camera: Camera
    values: Tensor
    weight: Tensor


def seen_map(camera: Camera, values: np.ndarray, weight: np.ndarray) -> SeenMap:
    """A map (h, w, F) of a picture that `camera` took, at its own resolution; weight: (h, w)."""
    height, width = values.shape[:2]
    if weight.shape != (height, width):
        raise ValueError(f"weight: has shape {weight.shape}; expected {(height, width)}")
    return SeenMap(
        camera.resized(width, height),
        torch.as_tensor(values, dtype=torch.float32),
        torch.as_tensor(weight, dtype=torch.float32),
    )


def gathered(gaussians: Gaussians, camera: Camera, values: Tensor) -> Tensor:
    """The transpose of rendering: (K, F), for every Gaussian sum_p w_pk values_p of a map (h, w, F)."""
    pieces = []
    for first in range(0, values.shape[2], _CHANNELS):
        chunk = values[..., first : first + _CHANNELS]
        features = torch.zeros(gaussians.count, chunk.shape[2], requires_grad=True)
        picture = splat(replace(gaussians, features=features), camera)
        (gradient,) = torch.autograd.grad((picture.features * chunk).sum(), features)
        pieces.append(gradient)
    return torch.cat(pieces, dim=1)


def rendered(gaussians: Gaussians, camera: Camera, features: Tensor) -> Tensor:
    """The map (h, w, F) of features (K, F)."""
    with torch.no_grad():
        chunks = torch.split(features, _CHANNELS, dim=1)
        return torch.cat([splat(replace(gaussians, features=c), camera).features for c in chunks], dim=2)


def lifted_features(
    gaussians: Gaussians,
    maps: Sequence[SeenMap],
    *,
    steps: int = 6,
    damping: float = 0.3,
    report: Report | None = None,
) -> Tensor:
    """Features (K, F) of Gaussians that explain maps of them.

    First the mean of what is seen of each Gaussian, z0 = sum w f / sum w; then `steps` of conjugate gradients
    on sum_p weight_p |sum_k w_pk z_k - f_p|^2 + damping sum_k (sum_p w_pk) |z_k - z0_k|^2, preconditioned by
    its diagonal's bound sum_p w_pk. Gaussians that no view sees take the feature of the nearest that is seen.
    Raises ValueError for no maps, or maps of unlike numbers of channels.
    """
    if not maps or len({m.values.shape[2] for m in maps}) != 1:
        raise ValueError(f"maps: are {len(maps)}, expected at least one, all of one number of channels")
    plain = gaussians.each(lambda tensor: tensor.detach().to(torch.float32))
    channels = maps[0].values.shape[2]
    total = torch.zeros(plain.count, channels + 1)
    for number, seen in enumerate(maps):
        if report is not None:
            report(number / (len(maps) * (steps + 1)), "features to Gaussians: means")
        both = torch.cat([seen.values, torch.ones_like(seen.values[..., :1])], dim=2)
        total += gathered(plain, seen.camera, both * seen.weight[..., None])
    amount = total[:, -1:]
    start = total[:, :-1] / amount.clamp_min(1e-12)
    unseen = amount[:, 0] < _LEAST_SEEN
    start = _filled(plain.positions, start, unseen)
    inverse = 1.0 / ((1.0 + damping) * amount.clamp_min(_LEAST_SEEN))

    def normal(features: Tensor) -> Tensor:
        result = damping * amount * features
        for seen in maps:
            picture = rendered(plain, seen.camera, features) * seen.weight[..., None]
            result = result + gathered(plain, seen.camera, picture)
        return result

    # in terms of z - z0 the right side is A'W (f - A z0), damping falls away
    change = torch.zeros_like(start)
    residual = total[:, :-1] + damping * amount * start - normal(start) if steps else change
    direction = inverse * residual
    slope = (residual * direction).sum(dim=0)
    for step in range(steps):
        if report is not None:
            report((step + 1) / (steps + 1), "features to Gaussians: least squares")
        product = normal(direction)
        curvature = (direction * product).sum(dim=0)
        length = torch.where(curvature > 0, slope / curvature.clamp_min(1e-30), 0.0)
        change = change + length * direction
        residual = residual - length * product
        new = inverse * residual
        new_slope = (residual * new).sum(dim=0)
        direction = new + torch.where(slope > 0, new_slope / slope.clamp_min(1e-30), 0.0) * direction
        slope = new_slope
    return _filled(plain.positions, start + change, unseen)


def _filled(positions: Tensor, features: Tensor, unseen: Tensor) -> Tensor:
    """Features with the rows `unseen` those of the nearest seen Gaussian."""
    if not unseen.any() or unseen.all():
        return features
    places = positions.detach().numpy()
    known = torch.nonzero(~unseen)[:, 0]
    nearest = cKDTree(places[known.numpy()]).query(places[unseen.numpy()])[1]
    result = features.clone()
    result[unseen] = features[known[torch.from_numpy(nearest)]]
    return result


def seen_in_groups(gaussians: Gaussians, camera: Camera, groups: np.ndarray) -> sparse.csr_matrix:
    """(K, G) what is seen of each Gaussian in each group [px]; groups: (h, w) int, -1 for none."""
    height, width = groups.shape
    small = camera.resized(width, height)
    count = int(groups.max(initial=-1)) + 1
    pieces = [sparse.csr_matrix((gaussians.count, 0))]
    for first in range(0, count, _CHANNELS):
        number = np.arange(first, min(first + _CHANNELS, count))
        chosen = torch.from_numpy((groups[..., None] == number).astype(np.float32))
        pieces.append(sparse.csr_matrix(gathered(gaussians, small, chosen).numpy()))
    return sparse.hstack(pieces).tocsr()
