"""Gaussians carried by particles, errors of pictures over ranges, films."""

from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from mphygs.capture.cameras import Camera, looking_at
from mphygs.capture.rotation import matrix_from_rotation_vector
from mphygs.capture.views import Photograph
from mphygs.compare.carried_gaussians import CarriedGaussians, thinned
from mphygs.compare.image_errors import (
    ComparedFrame,
    Film,
    frame_metrics,
    image_table,
    joined_errors,
    range_errors,
)
from mphygs.render.image_metrics import ImageMetrics
from mphygs.render.splatting import splat
from mphygs.scene.first_gaussians import gaussians_at
from mphygs.scene.gaussians import Gaussians
from mphygs.scene.tensor_rotation import rotation_matrices

CAMERA = Camera(
    "a", 48, 40, np.array([60.0, 60.0]), np.array([24.0, 20.0]), looking_at((0.3, 0.2, 0.1), (0, 0, 0))
)


def rod() -> tuple[Gaussians, np.ndarray]:
    """Gaussians on a rod of 100 x 10 x 4 mm, and particles that fill it."""
    rng = np.random.default_rng(0)
    size = np.array([0.1, 0.01, 0.004])
    points = (rng.uniform(size=(300, 3)) - 0.5) * size
    axes = [np.linspace(-0.5, 0.5, n) * s for n, s in zip((51, 6, 3), size, strict=True)]
    particles = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    colours = rng.uniform(size=(300, 3))
    return gaussians_at(points, colours, np.zeros((300, 0))), particles


def bent(points: np.ndarray, curvature: float) -> np.ndarray:
    """The rod bent into an arc [1/m]."""
    angle = curvature * points[:, 0]
    radius = 1.0 / curvature + points[:, 1]
    return np.stack([radius * np.sin(angle), radius * np.cos(angle) - 1.0 / curvature, points[:, 2]], axis=1)


def test_a_rigid_motion_carries_places_and_turns_exactly() -> None:
    gaussians, particles = rod()
    drawn = CarriedGaussians.of(gaussians, particles, count=400)
    rotation, shift = matrix_from_rotation_vector(np.array([0.5, -1.2, 0.7])), np.array([0.1, 0.2, -0.3])
    moved = drawn.at(torch.from_numpy(drawn.carriers @ rotation.T + shift))
    expected = gaussians.positions.double().numpy() @ rotation.T + shift
    assert np.abs(moved.positions.numpy() - expected).max() < 1e-6
    turned = rotation_matrices(moved.rotations).double().numpy()
    assert np.abs(turned - rotation @ rotation_matrices(gaussians.rotations).double().numpy()).max() < 1e-5
    assert torch.equal(moved.scales, gaussians.scales) and torch.equal(moved.opacities, gaussians.opacities)


def test_a_bend_carries_places_and_turns_locally() -> None:
    gaussians, particles = rod()
    drawn = CarriedGaussians.of(gaussians, particles, count=400)
    moved = drawn.at(torch.from_numpy(bent(drawn.carriers, 8.0)))
    rest = gaussians.positions.double().numpy()
    assert np.abs(moved.positions.numpy() - bent(rest, 8.0)).max() < 3e-4
    angle = -8.0 * rest[:, 0]
    first = rotation_matrices(moved.rotations).double().numpy()[:, :, 0]
    assert np.abs(np.arctan2(first[:, 1], first[:, 0]) - angle).max() < 0.05


def test_slope_by_the_carriers_is_that_of_differences() -> None:
    gaussians, particles = rod()
    drawn = CarriedGaussians.of(gaussians, particles, count=60)
    base = torch.from_numpy(bent(drawn.carriers, 6.0)).requires_grad_()
    weight = torch.from_numpy(np.random.default_rng(2).standard_normal((300, 7)))

    def value(at: torch.Tensor) -> torch.Tensor:
        moved = drawn.at(at)
        return (weight * torch.cat([100 * moved.positions, moved.rotations], 1).double()).sum()

    value(base).backward()
    direction = np.random.default_rng(3).standard_normal(base.shape) * 1e-4
    step = torch.from_numpy(direction)
    with torch.no_grad():
        difference = float(value(base + step) - value(base - step)) / 2
    slope = float((base.grad * step).sum())
    assert abs(slope) > 1e-3 and difference == pytest.approx(slope, rel=0.02, abs=2e-4)


def test_thinning_keeps_points_of_the_set_and_covers_it() -> None:
    _, particles = rod()
    few = thinned(particles, 100)
    assert 60 < len(few) <= 100 and all((particles == point).all(1).any() for point in few)
    assert np.linalg.norm(particles[:, None] - few, axis=2).min(1).max() < 0.006
    assert np.array_equal(thinned(particles, 10_000), particles)
    with pytest.raises(ValueError, match="expected more than"):
        CarriedGaussians.of(rod()[0], particles[:5])


def shown(frame: int, offset: float = 0.0) -> ComparedFrame:
    """A rod, and what a camera sees of it shifted [m]."""
    gaussians, particles = rod()
    drawn = CarriedGaussians.of(gaussians, particles, count=100)
    seen = splat(gaussians, CAMERA)
    mask = (seen.opacity >= 0.5).float().numpy()
    photograph = Photograph(CAMERA, seen.colour.numpy(), mask)
    moved = drawn.at(torch.from_numpy(drawn.carriers + [0, 0, offset]))
    return ComparedFrame(frame, [splat(moved, CAMERA)], [photograph])


def test_errors_are_those_of_their_frames() -> None:
    same, apart = frame_metrics(shown(0)), frame_metrics(shown(1, 0.01))
    assert same.iou > 0.99 and same.chamfer_px < 0.01 and apart.iou < 0.8 * same.iou
    metrics = {0: same, 1: same, 2: apart, 3: apart}
    found = range_errors(metrics, (0, 2), (1, 4))
    assert found["fit"]["iou"] == pytest.approx(same.iou) and found["predict"]["iou"] == pytest.approx(
        apart.iou
    )
    assert found["all"]["psnr"] == pytest.approx((same.psnr + apart.psnr) / 2)
    assert range_errors(metrics, (0, 0), (0, 4))["fit"] is None


def test_points_and_pictures_join() -> None:
    point = {"rms": 1e-3, "max": 2e-3, "rms_over_sigma": 1.0, "count": 5}
    image = {"psnr": 20.0, "iou": 0.9, "chamfer_px": 1.5}
    both = joined_errors(
        {"a": {"fit": point, "predict": None, "all": point}}, {"a": {"fit": image}, "b": {"all": image}}
    )
    assert both["a"]["fit"] == point | image and both["a"]["predict"] is None and both["a"]["all"] == point
    assert both["b"]["all"]["rms"] is None and both["b"]["all"]["iou"] == 0.9
    rows = image_table(both)
    assert rows[1] == ["a", "fit", "20.00", "90.0", "1.50"] and len(rows) == 3


def test_a_film_shows_both_sides(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "film.mp4"
    with Film(path, 25.0) as film:
        for frame in range(5):
            film.add(shown(frame, 0.002 * frame))
    video = cv2.VideoCapture(str(path))
    assert int(video.get(cv2.CAP_PROP_FRAME_COUNT)) == 5 and video.get(cv2.CAP_PROP_FPS) == 25.0
    image = video.read()[1]
    assert image.shape == (40, 96, 3)
    assert np.abs(image[:, :48].astype(float) - image[:, 48:]).mean() < 6.0 < image.max()


def test_metrics_are_a_mean() -> None:
    found = range_errors({0: ImageMetrics(10, 0.5, 1), 1: ImageMetrics(20, 1.0, 3)}, (0, 2), (0, 0))
    assert found["fit"] == {"psnr": 15.0, "iou": 0.75, "chamfer_px": 2.0}
