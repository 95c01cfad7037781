"""Where Gaussians are too few or of no use: cloned, split and pruned (Kerbl et al. 2023, section 5.2)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from mphygs.render.raw_gaussians import RawGaussians
from mphygs.scene.tensor_rotation import rotation_matrices

_CHILDREN = 2
_SHRINK = 0.8 * _CHILDREN  # of a Gaussian that is split


@dataclass(frozen=True)
class DensityRule:
    """When Gaussians are changed.

    gradient: mean length of the gradient with respect to the projected centre, in halves of the picture, from
    which a Gaussian is too coarse [1]; small: scale up to which it is cloned and not split, largest: scale
    from which it is taken away, shares of the object's extent [1]; faint: opacity below which it is taken
    away [1]; most: number of Gaussians that is not exceeded.
    """

    gradient: float = 2e-4
    small: float = 0.01
    largest: float = 0.2
    faint: float = 0.02
    most: int = 50_000

    def __post_init__(self) -> None:
        if min(self.gradient, self.small, self.largest, self.faint) <= 0 or self.most < 1:
            raise ValueError(f"{self}: expected every number above zero")


class DensityControl:
    """Gathers the gradients of views between changes. extent: size of the object [m]."""

    def __init__(self, rule: DensityRule, *, extent: float, count: int, seed: int) -> None:
        self._rule, self._extent = rule, extent
        self._draw = torch.Generator().manual_seed(seed)
        self._reset(count)

    def _reset(self, count: int) -> None:
        self._length, self._views = torch.zeros(count), torch.zeros(count)

    def add(self, screen_gradient: Tensor, visible: Tensor, size: int) -> None:
        """Note the gradient (N, 2) [1/px] of one view, `size` pixels along its longest side."""
        self._length[visible] += 0.5 * size * screen_gradient[visible].norm(dim=1)
        self._views[visible] += 1

    def change(self, raw: RawGaussians, *, grow: bool = True) -> None:
        """Prune, and where `grow` also clone and split, by what was gathered; then gather anew."""
        with torch.no_grad():
            values = raw.values
            scales = values["log_scales"].exp().amax(dim=1)
            kept = torch.sigmoid(values["logit_opacities"]) >= self._rule.faint
            kept &= scales <= self._rule.largest * self._extent
            chosen = torch.zeros_like(kept)
            if grow:
                mean = self._length / self._views.clamp_min(1)
                room = max(self._rule.most - int(kept.sum()), 0)
                order = torch.argsort(torch.where(kept, mean, 0.0), descending=True, stable=True)[:room]
                chosen[order] = mean[order] > self._rule.gradient
                chosen &= kept
            split = chosen & (scales > self._rule.small * self._extent)
            parents = torch.nonzero(split)[:, 0].repeat(_CHILDREN)
            rows = torch.cat([torch.nonzero(chosen & ~split)[:, 0], parents])
            added = {name: value.detach()[rows].clone() for name, value in values.items()}
            if len(parents):
                first = len(rows) - len(parents)
                spread = (
                    torch.randn(len(parents), 3, generator=self._draw) * values["log_scales"][parents].exp()
                )
                turned = rotation_matrices(values["rotations"][parents]) @ spread[..., None]
                added["positions"][first:] += turned[..., 0]
                added["log_scales"][first:] -= torch.log(torch.tensor(_SHRINK))
        raw.rebuild(kept & ~split, added)
        self._reset(raw.count)
