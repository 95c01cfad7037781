"""Splatting in plain torch, any precision: what the compiled kernel is checked against. Slow."""

from __future__ import annotations

import torch
from torch import Tensor

from mphygs.capture.cameras import Camera
from mphygs.render.harmonics import seen_colours
from mphygs.render.picture import (
    Optics,
    Picture,
    checked_background,
    checked_screen_offsets,
    picture_of,
)
from mphygs.render.projection import project_points, projected_covariances
from mphygs.scene.gaussians import Gaussians

LEAST_ALPHA = 1.0 / 255.0
MOST_ALPHA = 0.99
LEAST_TRANSMITTANCE = 1e-4
_BLOCK = 16  # pixels across a block that is computed at once


def splat_by_oracle(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: Tensor | None = None,
    screen_offsets: Tensor | None = None,
    optics: Optics = Optics(),  # noqa: B008 (frozen)
) -> Picture:
    """As `splat`, by broadcasting over pixels and Gaussians block by block; gradients by autograd.

    Pixel by pixel, front to back: alpha = min(0.99, opacity exp(-s)), nothing below 1/255; a pixel is closed
    by the first Gaussian that would let less than 1e-4 through (Kerbl et al. 2023).
    """
    checked_background(background, camera)
    checked_screen_offsets(screen_offsets, gaussians)
    depth = project_points(camera, gaussians.positions.detach())[1]
    drawn = torch.nonzero((depth > optics.nearest) & (gaussians.opacities.detach() > LEAST_ALPHA))[:, 0]
    drawn = drawn[torch.argsort(depth[drawn], stable=True)]
    chosen = gaussians.each(lambda tensor: tensor[drawn])
    centres, depths = project_points(camera, chosen.positions)
    if screen_offsets is not None:
        centres = centres + screen_offsets[drawn]
    covariances = projected_covariances(camera, chosen, optics.blur)
    inverses = torch.linalg.inv(covariances)
    reach = torch.log(chosen.opacities.detach() / LEAST_ALPHA)
    extents = torch.sqrt(2 * reach[:, None] * covariances.detach().diagonal(dim1=-2, dim2=-1))
    eye = centres.new_tensor(camera.position)
    colours = seen_colours(chosen.harmonics, chosen.positions, eye)
    values = torch.cat([colours, depths[:, None], chosen.features], dim=1)

    rows, seen = [], torch.zeros(len(drawn), dtype=torch.bool)
    for top in range(0, camera.height, _BLOCK):
        blocks = []
        for left in range(0, camera.width, _BLOCK):
            bottom, right = min(top + _BLOCK, camera.height), min(left + _BLOCK, camera.width)
            v, u = torch.meshgrid(torch.arange(top, bottom), torch.arange(left, right), indexing="ij")
            pixels = torch.stack([u, v], dim=-1).to(centres) + 0.5
            low, high = pixels[0, 0] - extents, pixels[-1, -1] + extents
            at = centres.detach()
            near = torch.nonzero(((at >= low) & (at <= high)).all(dim=1))[:, 0]
            seen[near] = True
            weights, through = _weights(
                pixels.reshape(-1, 2), centres[near], inverses[near], chosen.opacities[near], reach[near]
            )
            block = torch.cat([weights @ values[near], through[:, None]], dim=1)
            blocks.append(block.reshape(bottom - top, right - left, -1))
        rows.append(torch.cat(blocks, dim=1))
    image = torch.cat(rows, dim=0).permute(2, 0, 1)
    return picture_of(image[:-1], image[-1], drawn[seen], background)


def _weights(
    pixels: Tensor, centres: Tensor, inverses: Tensor, opacities: Tensor, reach: Tensor
) -> tuple[Tensor, Tensor]:
    """Weights (P, N) of Gaussians sorted by depth at pixels (P, 2); the transmittance (P,) behind them."""
    offset = pixels[:, None, :] - centres
    s = 0.5 * torch.einsum("pni,nij,pnj->pn", offset, inverses, offset)
    alpha = torch.where(s <= reach, (opacities * torch.exp(-s)).clamp_max(MOST_ALPHA), 0.0)
    after = torch.cumprod(1.0 - alpha, dim=1)
    is_open = after.detach() >= LEAST_TRANSMITTANCE
    before = torch.cat([after.new_ones(len(after), 1), after], dim=1)
    weights = torch.where(is_open, alpha * before[:, :-1], 0.0)
    # what is left behind the last Gaussian shown
    shown = is_open.sum(dim=1, keepdim=True)
    return weights, torch.gather(before, 1, shown)[:, 0]
