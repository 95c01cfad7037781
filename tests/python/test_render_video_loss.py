"""L_2D is the sum of its parts and leads displaced Gaussians home."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from gaussian_example import camera, gaussians
from mesh_picture import cameras_around
from mphygs.capture.views import Photograph
from mphygs.render.splatting import splat
from mphygs.render.video_loss import VideoWeights, observation_of, video_loss
from mphygs.scene.gaussians import Gaussians


@pytest.fixture(scope="module")
def scene() -> tuple[Gaussians, list[Photograph], list[torch.Tensor]]:
    drawn = gaussians(60, degree=0, features=3, size=0.01).each(torch.Tensor.float)
    drawn = replace(drawn, positions=0.4 * drawn.positions, opacities=torch.full((60,), 0.9))
    photographs, maps = [], []
    for eye in [*cameras_around(3, 40), camera(40, 40)]:
        picture = splat(drawn, eye)
        photographs.append(Photograph(eye, picture.colour.numpy().copy(), np.ones((40, 40), np.float32)))
        photographs[-1].mask[picture.opacity.numpy() < 0.5] = 0
        maps.append(picture.features.reshape(10, 4, 10, 4, 3).mean((1, 3)))
    return drawn, photographs, maps


def test_parts_and_weights(scene: tuple[Gaussians, list[Photograph], list[torch.Tensor]]) -> None:
    drawn, photographs, maps = scene
    seen = [observation_of(*pair) for pair in zip(photographs, maps, strict=True)]
    away = replace(drawn, positions=drawn.positions + torch.tensor([0.02, 0.0, 0.0]))
    here, there = video_loss(drawn, seen), video_loss(away, seen)
    for name in ("total", "colour", "features", "distance"):
        assert getattr(there, name) > 1.5 * getattr(here, name), name
    expected = 0.1 * there.colour + 0.1 * there.features + 1e-3 * there.distance
    assert there.total.item() == pytest.approx(expected.item())
    only = video_loss(away, seen, weights=VideoWeights(colour=0, features=0, distance=2))
    assert only.total.item() == pytest.approx(2 * there.distance.item()) and only.colour == 0
    none = video_loss(away, [observation_of(photograph) for photograph in photographs])
    assert none.features == 0 and none.colour == there.colour
    with pytest.raises(ValueError, match="observations: are none"):
        video_loss(drawn, [])
    with pytest.raises(ValueError, match="expected no weight below zero"):
        VideoWeights(colour=-1)


@pytest.mark.parametrize("parts", [VideoWeights(), VideoWeights(features=0, distance=0)])
def test_a_displaced_object_is_led_home(
    scene: tuple[Gaussians, list[Photograph], list[torch.Tensor]], parts: VideoWeights
) -> None:
    drawn, photographs, maps = scene
    seen = [observation_of(*pair) for pair in zip(photographs, maps, strict=True)]
    shift = torch.tensor([0.006, -0.004, 0.003], requires_grad=True)
    start = shift.detach().norm().item()
    adam = torch.optim.Adam([shift], lr=4e-4)
    for _ in range(60):
        adam.zero_grad()
        video_loss(replace(drawn, positions=drawn.positions + shift), seen, weights=parts).total.backward()
        adam.step()
    assert shift.detach().norm().item() < 0.12 * start
