"""Pictures of an object that is given without any."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gaussian_example import gaussians
from mphygs.render.orbit_views import pictures_all_round, seen_depths
from mphygs.scene.gaussians import Gaussians


def an_object(size: float) -> Gaussians:
    """Opaque Gaussians in an object `size` times 0.1 m, far from the origin, and a faint one far away."""
    found = gaussians(200, size=0.004).each(lambda tensor: tensor.float())
    places = size * found.positions + torch.tensor([0.5, -0.3, 0.2])
    places[0] += 2.0
    opacities = torch.full_like(found.opacities, 0.95)
    opacities[0] = 0.01
    return replace(found, positions=places, scales=size * found.scales, opacities=opacities)


@pytest.mark.parametrize("size", [0.2, 1.0, 30.0])
def test_the_whole_object_is_in_every_picture_whatever_its_size(size: float) -> None:
    found = an_object(size)
    pictures = pictures_all_round(found, count=9, size=48)
    assert len({p.camera.name for p in pictures}) == 9
    for picture, depth in zip(pictures, seen_depths(found, pictures), strict=True):
        seen = picture.mask >= 0.5
        border = np.concatenate([seen[0], seen[-1], seen[:, 0], seen[:, -1]])
        assert not border.any()
        row, column = np.nonzero(seen)
        assert max(np.ptp(row), np.ptp(column)) > 0.35 * 48
        assert np.isfinite(depth[picture.mask > 0.55]).all() and np.isinf(depth[picture.mask < 0.45]).all()
    # from all sides: their directions add up to little
    forward = np.array([p.camera.camera_from_world[2, :3] for p in pictures])
    assert np.linalg.norm(forward.mean(axis=0)) < 0.15


def test_what_cannot_be_seen_is_refused() -> None:
    found = an_object(1.0)
    with pytest.raises(ValueError, match="none is opaque"):
        pictures_all_round(replace(found, opacities=torch.full_like(found.opacities, 0.01)))
