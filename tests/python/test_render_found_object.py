"""The solid, the particles and the parts of an object that Gaussians show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from mphygs.capture.views import Photograph
from mphygs.render.found_object import ObjectSettings, found_object
from mphygs.render.orbit_views import pictures_all_round
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.object_files import GaussianFeatures
from mphygs.scene.segments import SegmentSettings

RADIUS, COUNT, SIZE = 0.03, 1200, 0.002
SETTINGS = ObjectSettings(particles=1500, thickness=0.0, segments=SegmentSettings(most=2, least_cluster=0.1))


def ball(floating: int = 0) -> Gaussians:
    """Small opaque Gaussians on a sphere, evenly, the first `floating` of them moved far away."""
    number = np.arange(COUNT)
    height = 1.0 - 2.0 * (number + 0.5) / COUNT
    turn = np.pi * (3.0 - np.sqrt(5.0)) * number
    ring = np.sqrt(1.0 - height**2)
    places = RADIUS * np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    places[:floating, 0] += 3.0
    return Gaussians(
        positions=torch.as_tensor(places, dtype=torch.float32),
        rotations=torch.tensor([1.0, 0, 0, 0]).repeat(COUNT, 1),
        scales=torch.full((COUNT, 3), SIZE),
        opacities=torch.full((COUNT,), 0.9),
        harmonics=torch.zeros(COUNT, 1, 3),
        features=torch.zeros(COUNT, 0),
    )


def halves(gaussians: Gaussians) -> GaussianFeatures:
    """Features by which the two halves of the ball are told apart."""
    side = np.sign(gaussians.positions.numpy()[:, 1:2]).astype(np.float32)
    return GaussianFeatures(side, np.zeros((gaussians.count, 1), np.float32), "sides")


def radius_seen(pictures: list[Photograph]) -> float:
    """Radius [m] of the ball with these silhouettes, on which Gaussians reach beyond their centres."""
    found = []
    for picture in pictures:
        camera = picture.camera
        across = np.sqrt((picture.mask >= 0.5).sum() / np.pi) / camera.focal[0]
        found.append(np.linalg.norm(camera.position) * np.sin(np.arctan(across)))
    return float(np.mean(found))


@pytest.fixture(scope="module")
def pictures() -> list[Photograph]:
    return pictures_all_round(ball(), count=14, size=96)


def test_parts_together_fill_the_solid_and_what_floats_does_not_count(pictures: list[Photograph]) -> None:
    for floating in (0, 2):
        gaussians = ball(floating)
        found = found_object(gaussians, halves(gaussians), pictures, SETTINGS)
        particles = found.particles
        volume = sum(part.volume for part in found.parts)
        assert volume == pytest.approx(4 / 3 * np.pi * radius_seen(pictures) ** 3, rel=0.04)
        assert volume == pytest.approx(particles.inside.sum() * particles.spacing**3, rel=0.03)
        assert [part.name for part in found.parts] == ["segment-00", "segment-01"]
        pixel = np.median([np.linalg.norm(p.camera.position) / p.camera.focal[0] for p in pictures])
        assert particles.pixel == pytest.approx(pixel, rel=0.05)
        side = particles.position[:, 1] > 0
        clear = np.abs(particles.position[:, 1]) > 0.25 * RADIUS
        same = (particles.label > 0) == side
        assert max(same[clear].mean(), 1 - same[clear].mean()) > 0.97
        assert np.abs(particles.position).max() < 1.5 * RADIUS


def test_what_shows_no_object_is_refused(pictures: list[Photograph]) -> None:
    gaussians = ball()
    faint = replace(gaussians, opacities=torch.full((COUNT,), 0.01))
    with pytest.raises(ValueError, match="0 are opaque"):
        found_object(faint, halves(gaussians), pictures, SETTINGS)
    away = replace(gaussians, positions=gaussians.positions + 5.0)
    with pytest.raises(ValueError, match="none lies where"):
        found_object(away, halves(gaussians), pictures, SETTINGS)
    with pytest.raises(ValueError, match="200 particles"):
        ObjectSettings(particles=100)
