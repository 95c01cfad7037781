"""Losses and metrics between pictures have the values their formulas give."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from gaussian_example import camera
from mphygs.capture.views import Photograph
from mphygs.render.distance_maps import distance_loss, distance_map, sampled_map
from mphygs.render.image_losses import feature_loss, image_loss, similarity_by_torch, structural_similarity
from mphygs.render.image_metrics import (
    ImageMetrics,
    chamfer_distance,
    image_metrics,
    intersection_over_union,
    mean_metrics,
    peak_signal_to_noise,
)
from mphygs.render.picture import Picture
from mphygs.render.projection import project_points


def noise(*shape: int, seed: int = 0) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_structural_similarity_has_the_value_of_its_formula() -> None:
    a, b = noise(40, 36, 3), noise(40, 36, 3, seed=1)
    b = 0.6 * a + 0.4 * b

    def blurred(image: torch.Tensor) -> np.ndarray:
        channels = [gaussian_filter(image[..., c].numpy(), 1.5, mode="constant", radius=5) for c in range(3)]
        return np.stack(channels, -1)

    mean_a, mean_b = blurred(a), blurred(b)
    variance = blurred(a * a) - mean_a**2 + blurred(b * b) - mean_b**2
    covariance = blurred(a * b) - mean_a * mean_b
    expected = (2 * mean_a * mean_b + 1e-4) / (mean_a**2 + mean_b**2 + 1e-4)
    expected = (expected * (2 * covariance + 9e-4) / (variance + 9e-4)).mean()
    assert 0.3 < expected < 0.95
    assert structural_similarity(a, b).item() == pytest.approx(expected, abs=1e-9)
    assert structural_similarity(a, a).item() == pytest.approx(1.0)


def test_compiled_similarity_agrees_with_the_plain_one() -> None:
    draw = noise(37, 21, 3)
    a, b = draw.float().requires_grad_(), (0.5 * draw + 0.5 * noise(37, 21, 3, seed=1)).float()
    exact = a.detach().double().requires_grad_()
    value, expected = structural_similarity(a, b), similarity_by_torch(exact, b.double())
    assert value.dtype == torch.float32 and value.item() == pytest.approx(expected.item(), abs=1e-6)
    value.backward()
    expected.backward()
    torch.testing.assert_close(a.grad.double(), exact.grad, atol=1e-5 * exact.grad.abs().max().item(), rtol=0)
    assert torch.equal(torch.autograd.grad(2 * structural_similarity(a, b), a)[0], 2 * a.grad)


def test_image_loss() -> None:
    a, b = noise(32, 24, 3), noise(32, 24, 3, seed=1)
    assert image_loss(a, a, scales=3).item() == pytest.approx(0.0, abs=1e-12)
    assert image_loss(a, b, dssim=0.0).item() == pytest.approx((a - b).abs().mean().item())
    single = 0.8 * (a - b).abs().mean() + 0.2 * (1 - structural_similarity(a, b))
    assert image_loss(a, b).item() == pytest.approx(single.item())
    half = [image.reshape(16, 2, 12, 2, 3).mean((1, 3)) for image in (a, b)]
    two = 0.5 * (single + image_loss(*half))
    assert image_loss(a, b, scales=2).item() == pytest.approx(two.item())
    # 12 pixels are not halved any further
    assert image_loss(a, b, scales=9).item() == pytest.approx(two.item())
    torch.autograd.gradcheck(lambda x: image_loss(x, b[:9, :9]), a[:9, :9].clone().requires_grad_())
    with pytest.raises(ValueError, match=r"shapes \(32, 24, 3\) and \(16, 12, 3\)"):
        image_loss(a, half[0])
    with pytest.raises(ValueError, match="scales 0"):
        image_loss(a, b, scales=0)


def test_feature_loss() -> None:
    seen, wanted = noise(32, 32, 5), noise(8, 8, 5, seed=1)
    coarse = seen.reshape(8, 4, 8, 4, 5).mean((1, 3))
    assert feature_loss(seen, wanted, scales=1).item() == pytest.approx((coarse - wanted).abs().mean().item())
    assert feature_loss(seen, coarse).item() == pytest.approx(0.0, abs=1e-12)
    weight = torch.zeros(8, 8, dtype=torch.float64)
    weight[2, 3] = 1
    only = feature_loss(seen, wanted, weight=weight, scales=1)
    assert only.item() == pytest.approx((coarse - wanted).abs()[2, 3].mean().item())
    with pytest.raises(ValueError, match="features have shapes"):
        feature_loss(seen, wanted[..., :3])


def test_distance_map_and_its_samples() -> None:
    mask = np.zeros((20, 30))
    mask[5:10, 5:10] = 1
    away = distance_map(mask)
    assert away[7, 7] == 0 and away[7, 15] == 6 and away[12, 12] == pytest.approx(math.hypot(3, 3), abs=1e-5)
    pixels = torch.tensor([[15.5, 7.5], [16.0, 7.5], [99.0, 7.5]])
    assert sampled_map(away, pixels).tolist() == pytest.approx([6, 6.5, 20])
    with pytest.raises(ValueError, match="mask: is empty"):
        distance_map(np.zeros((4, 4)))


def test_distance_loss_pulls_centres_into_the_mask() -> None:
    eye = camera()
    mask = np.zeros((eye.height, eye.width))
    mask[:, :5] = 1
    behind = 2 * eye.position
    positions = torch.tensor(np.stack([np.zeros(3), [0.02, 0.01, 0.0], behind]), requires_grad=True)
    loss = distance_loss(positions, [eye], [distance_map(mask)])
    pixels, _ = project_points(eye, positions.detach()[:2])
    # the mask ends at u = 5; its last pixel has its centre at 4.5
    assert loss.item() == pytest.approx(((pixels[:, 0] - 4.5).sum() / 3).item(), rel=1e-5)
    loss.backward()
    moved = positions.detach() - 1e-4 * positions.grad
    assert (project_points(eye, moved[:2])[0][:, 0] < pixels[:, 0]).all() and not positions.grad[2].any()
    with pytest.raises(ValueError, match="expected one map a camera"):
        distance_loss(positions, [eye], [])
    with pytest.raises(ValueError, match='camera "front": map is'):
        distance_loss(positions, [eye], [distance_map(mask.T)])


def test_metrics() -> None:
    a = np.zeros((20, 30))
    a[5:15, 5:15] = 1
    b = np.roll(a, 3, axis=1)
    assert intersection_over_union(a, b) == pytest.approx(7 / 13)
    # three columns of ten stick out on either side, 1, 2 and 3 pixels away
    assert chamfer_distance(a, b) == pytest.approx(10 * (1 + 2 + 3) / 100)
    assert chamfer_distance(a, a) == 0 and intersection_over_union(a, a) == 1
    empty = np.zeros_like(a)
    assert chamfer_distance(a, empty) == pytest.approx(math.hypot(20, 30))
    assert chamfer_distance(empty, empty) == 0 and intersection_over_union(empty, empty) == 1
    assert peak_signal_to_noise(a, a + 0.1) == pytest.approx(20.0)
    assert peak_signal_to_noise(a, a) == 100
    with pytest.raises(ValueError, match="masks have shapes"):
        chamfer_distance(a, a.T)
    with pytest.raises(ValueError, match="pictures have shapes"):
        peak_signal_to_noise(a, a.T)


def test_metrics_of_a_picture() -> None:
    mask = np.zeros((20, 30), np.float32)
    mask[5:15, 5:15] = 1
    colour = np.full((20, 30, 3), 0.5, np.float32)
    photograph = Photograph(camera(30, 20), colour, mask)
    seen = torch.from_numpy(mask)
    picture = Picture(
        0.6 * seen[..., None].repeat(1, 1, 3), seen, seen, seen[..., None][..., :0], torch.arange(0)
    )
    metrics = image_metrics(picture, photograph)
    assert mean_metrics([metrics, ImageMetrics(0.0, 0.5, 3.0)]).chamfer_px == 1.5
    with pytest.raises(ValueError, match="metrics: are none"):
        mean_metrics([])
    assert (metrics.iou, metrics.chamfer_px) == (1, 0)
    assert metrics.psnr == pytest.approx(-10 * math.log10(0.01 * 100 / 600), abs=1e-3)
