"""Features of Gaussians that explain maps: the transpose of rendering, and the least squares with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gaussian_example import gaussians
from mesh_picture import cameras_around
from mphygs.render.lifting import gathered, lifted_features, rendered, seen_in_groups, seen_map
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians


@pytest.fixture(scope="module")
def drawn() -> Gaussians:
    return gaussians(40, degree=0, features=0, size=0.008).each(torch.Tensor.float)


def test_gathering_is_the_transpose_of_rendering(drawn: Gaussians) -> None:
    camera = cameras_around(1, 32)[0]
    draw = torch.Generator().manual_seed(1)
    # more channels than are rendered together
    features, picture = torch.randn(40, 35, generator=draw), torch.randn(32, 32, 35, generator=draw)
    forward = (rendered(drawn, camera, features) * picture).sum()
    backward = (features * gathered(drawn, camera, picture)).sum()
    assert forward.item() == pytest.approx(backward.item(), rel=1e-4) and abs(forward.item()) > 1.0
    with_features = replace(drawn, features=features[:, :3])
    torch.testing.assert_close(
        rendered(drawn, camera, features)[..., :3], splat(with_features, camera).features
    )


def test_features_are_found_again_from_their_maps(drawn: Gaussians) -> None:
    cameras = cameras_around(9, 48)
    truth = torch.randn(40, 3, generator=torch.Generator().manual_seed(2))
    maps, amount = [], torch.zeros(40)
    for camera in cameras:
        picture = rendered(drawn, camera, truth).numpy()
        maps.append(seen_map(camera, picture, np.ones((48, 48), np.float32)))
        amount += gathered(drawn, camera, torch.ones(48, 48, 1))[:, 0]
    well = amount > 5.0
    errors = {
        steps: float(
            (lifted_features(drawn, maps, steps=steps, damping=1e-3) - truth)[well].norm()
            / truth[well].norm()
        )
        for steps in (0, 3, 60)
    }
    assert well.sum() > 15 and errors[0] > 0.3
    assert errors[3] < 0.8 * errors[0] and errors[60] < 0.1 * errors[0]


def test_what_is_not_the_object_says_nothing(drawn: Gaussians) -> None:
    camera = cameras_around(1, 32)[0]
    values = np.full((32, 32, 1), 7.0, dtype=np.float32)
    values[:, 16:] = np.nan
    values[:, 16:] = 1e6
    weight = np.zeros((32, 32), np.float32)
    weight[:, :16] = 1.0
    found = lifted_features(drawn, [seen_map(camera, values, weight)], steps=0)
    # seen in part, or not at all and like the nearest that is
    assert found.numpy() == pytest.approx(7.0, abs=1e-3)
    with pytest.raises(ValueError, match="expected at least one"):
        lifted_features(drawn, [])
    with pytest.raises(ValueError, match="weight: has shape"):
        seen_map(camera, values, weight[:8])


def test_membership_adds_up_to_what_is_seen(drawn: Gaussians) -> None:
    camera = cameras_around(1, 32)[0]
    groups = np.full((32, 32), -1)
    groups[:, :16], groups[:, 16:] = 0, 33  # numbers between are empty groups
    found = seen_in_groups(drawn, camera, groups)
    assert found.shape == (40, 34) and found[:, 1:33].nnz == 0
    whole = gathered(drawn, camera, torch.ones(32, 32, 1))[:, 0].numpy()
    assert np.asarray(found.sum(axis=1))[:, 0] == pytest.approx(whole, rel=1e-4, abs=1e-5)
