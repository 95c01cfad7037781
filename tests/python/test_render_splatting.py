"""The compiled splatting kernel agrees with the plain one, in values and gradients, at any thread count."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch

from gaussian_example import camera, gaussians
from mphygs.capture.cameras import Camera
from mphygs.render.picture import Optics, Picture
from mphygs.render.reference_splatting import splat_by_oracle
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians, harmonics_of_colour, joined_gaussians

NAMES = ("positions", "rotations", "scales", "opacities", "harmonics", "features", "screen_offsets")


def channels(picture: Picture) -> torch.Tensor:
    """Everything a picture holds, (H, W, 5 + F)."""
    others = [picture.opacity[..., None], picture.depth[..., None], picture.features]
    return torch.cat([picture.colour, *others], dim=-1)


def facing(count: int, *, focal: float = 100.0, distance: float = 2.0, **changed: torch.Tensor) -> tuple:
    """Round grey Gaussians at the origin, and a camera `distance` [m] before them, 21 x 21."""
    pose = np.eye(4)
    pose[2, 3] = distance
    eye = Camera("eye", 21, 21, np.full(2, focal), np.full(2, 10.5), pose)
    parts = {
        "positions": torch.zeros(count, 3),
        "rotations": torch.tensor([[2.0, 0.0, 0.0, 0.0]]).repeat(count, 1),
        "scales": torch.full((count, 3), 0.04),
        "opacities": torch.full((count,), 0.6),
        "harmonics": harmonics_of_colour(torch.full((count, 3), 0.5)),
        "features": torch.zeros(count, 0),
    }
    return Gaussians(**parts | changed), eye


@pytest.mark.parametrize(
    ("degree", "features", "size", "width", "height"),
    [(0, 0, 0.012, 40, 30), (1, 3, 0.03, 33, 17), (2, 1, 0.006, 16, 16), (3, 9, 0.02, 50, 7)],
)
def test_kernel_agrees_with_the_plain_version(
    degree: int, features: int, size: float, width: int, height: int
) -> None:
    eye = camera(width, height)
    drawn = gaussians(80, degree=degree, features=features, size=size, seed=degree)
    offsets = torch.zeros(80, 2, dtype=torch.float64)
    background = torch.linspace(0, 1, height * width * 3, dtype=torch.float64).reshape(height, width, 3)
    weight = torch.randn(
        height, width, 5 + features, generator=torch.Generator().manual_seed(1), dtype=torch.float64
    )
    results = []
    for function, dtype in ((splat_by_oracle, torch.float64), (splat, torch.float32)):
        own = drawn.each(lambda tensor, dtype=dtype: tensor.clone().to(dtype).requires_grad_())
        moved = offsets.clone().to(dtype).requires_grad_()
        picture = function(own, eye, background=background.to(dtype), screen_offsets=moved)
        (channels(picture) * weight.to(dtype)).sum().backward()
        results.append((picture, [tensor.grad for tensor in (*own.tensors(), moved)]))
    (plain, plain_gradients), (compiled, compiled_gradients) = results
    assert plain.opacity.max() > 0.8, "the scene is too faint to test with"
    torch.testing.assert_close(channels(compiled).double(), channels(plain), atol=2e-5, rtol=0)
    assert torch.equal(compiled.visible, plain.visible)
    for name, have, want in zip(NAMES, compiled_gradients, plain_gradients, strict=True):
        if want.numel() == 0:
            continue
        scale = want.abs().max().item()
        assert scale > 1e-2, f"{name}: the test has no gradient"
        torch.testing.assert_close(have.double(), want, atol=2e-5 * scale, rtol=0, msg=name)


def test_gradient_of_the_plain_version_agrees_with_differences() -> None:
    """Central differences in float64 along a random direction of each argument."""
    eye = camera(24, 20)
    drawn = gaussians(25, degree=3, features=2)
    tensors = [*drawn.tensors(), torch.zeros(25, 2, dtype=torch.float64)]
    draw = torch.Generator().manual_seed(3)
    weight = torch.randn(20, 24, 7, generator=draw, dtype=torch.float64)

    def value(*arguments: torch.Tensor) -> torch.Tensor:
        picture = splat_by_oracle(Gaussians(*arguments[:6]), eye, screen_offsets=arguments[6])
        return (channels(picture) * weight).sum()

    leaves = [tensor.clone().requires_grad_() for tensor in tensors]
    gradients = torch.autograd.grad(value(*leaves), leaves)
    for index, name in enumerate(NAMES):
        direction = torch.randn(tensors[index].shape, generator=draw, dtype=torch.float64)
        step = 1e-7
        ends = [
            value(*[t + sign * step * direction if k == index else t for k, t in enumerate(tensors)])
            for sign in (1, -1)
        ]
        difference = float(ends[0] - ends[1]) / (2 * step)
        exact = float((gradients[index] * direction).sum())
        assert abs(exact) > 0.1, name
        assert exact == pytest.approx(difference, rel=1e-5), name


def test_same_bits_at_any_thread_count() -> None:
    eye = camera(70, 50)
    results = []
    for threads in (1, 2, 5):
        own = gaussians(400, features=3).each(lambda tensor: tensor.float().requires_grad_())
        picture = splat(own, eye, threads=threads)
        channels(picture).square().sum().backward()
        results.append([channels(picture).detach(), *(tensor.grad for tensor in own.tensors())])
    for other in results[1:]:
        assert all(torch.equal(a, b) for a, b in zip(results[0], other, strict=True))


def test_one_round_gaussian_has_the_footprint_of_its_projection() -> None:
    drawn, eye = facing(1)
    picture = splat(drawn, eye)
    # 0.04 m at 2 m under a focal length of 100 px: 2 px, widened by the blur
    variance = 2.0**2 + 0.3
    for away in range(6):
        expected = 0.6 * math.exp(-(away**2) / (2 * variance))
        assert picture.opacity[10, 10 + away].item() == pytest.approx(expected, rel=1e-5)
        assert picture.opacity[10 - away, 10].item() == pytest.approx(expected, rel=1e-5)
        assert picture.colour[10, 10 - away, 1].item() == pytest.approx(0.5 * expected, rel=1e-5)
    assert picture.mean_depth()[10, 10].item() == pytest.approx(2.0)
    assert picture.opacity[0, 0] == 0 and math.isnan(picture.mean_depth()[0, 0])


def test_axes_and_turning() -> None:
    """Right and down in the picture are the camera's x and y; a quaternion turns the long axis."""
    half = math.sqrt(0.5)
    drawn, eye = facing(
        1,
        positions=torch.tensor([[0.06, -0.1, 0.0]]),
        scales=torch.tensor([[0.08, 0.01, 0.01]]),
        rotations=torch.tensor([[half, 0.0, 0.0, half]]),  # x onto y
    )
    opacity = splat(drawn, eye).opacity
    row, column = divmod(int(opacity.argmax()), 21)
    assert (row, column) == (5, 13)
    assert opacity[8, 13] > 0.1 > 10 * opacity[5, 16]


def test_the_nearer_one_hides_the_farther() -> None:
    drawn, eye = facing(
        3,
        positions=torch.tensor([[0.0, 0.0, 0.3], [0.0, 0.0, -0.3], [0.0, 0.0, -2.5]]),
        opacities=torch.tensor([0.5, 0.8, 0.9]),
        features=torch.tensor([[1.0, 0.0], [0.0, 1.0], [7.0, 7.0]]),
    )
    picture = splat(drawn, eye)
    assert picture.visible.tolist() == [1, 0], "the third stands behind the camera"
    torch.testing.assert_close(picture.features[10, 10], torch.tensor([0.2 * 0.5, 0.8]))
    assert picture.opacity[10, 10].item() == pytest.approx(0.9)
    assert picture.depth[10, 10].item() == pytest.approx(0.8 * 1.7 + 0.1 * 2.3)


def test_background_shows_through() -> None:
    drawn, eye = facing(1)
    picture = splat(drawn, eye, background=torch.tensor([1.0, 0.0, 0.5]))
    torch.testing.assert_close(picture.colour[10, 10], torch.tensor([0.7, 0.3, 0.5]))
    torch.testing.assert_close(picture.colour[0, 0], torch.tensor([1.0, 0.0, 0.5]))


def test_closed_pixels_show_nothing_more() -> None:
    depths = torch.linspace(0, 0.5, 6)
    positions = torch.stack([0 * depths, 0 * depths, depths], dim=1)
    drawn, eye = facing(6, positions=positions, opacities=torch.full((6,), 0.99), features=torch.eye(6))
    own = drawn.each(lambda tensor: tensor.clone().requires_grad_())
    picture = splat(own, eye)
    # 1 percent passes each; the second leaves 1e-4, rounding decides about the third
    assert (picture.features[10, 10, 2:] < 1e-4).all() and picture.features[10, 10, 0] > 0.98
    picture.colour[10, 10].sum().backward()
    assert own.harmonics.grad[5].abs().max() == 0 < own.harmonics.grad[0].abs().max()


def test_harmless_when_nothing_is_seen() -> None:
    drawn, eye = facing(2, positions=torch.tensor([[0.0, 0.0, -9.0], [torch.nan, 0.0, 0.0]]))
    own = drawn.each(lambda tensor: tensor.clone().requires_grad_())
    picture = splat(own, eye)
    assert len(picture.visible) == 0 and picture.opacity.abs().max() == 0
    picture.colour.sum().backward()
    assert all(not tensor.grad.abs().sum() for tensor in own.tensors())
    none = drawn.each(lambda tensor: tensor[:0])
    assert splat(none, eye).opacity.shape == (21, 21)
    assert splat_by_oracle(none, eye).opacity.shape == (21, 21)


def test_order_of_the_gaussians_does_not_matter() -> None:
    eye, drawn = camera(), gaussians(50).each(torch.Tensor.float)
    shuffled = torch.randperm(50, generator=torch.Generator().manual_seed(0))
    other = splat(drawn.each(lambda tensor: tensor[shuffled]), eye)
    assert torch.equal(channels(other), channels(splat(drawn, eye)))
    halves = joined_gaussians(drawn.each(lambda tensor: tensor[:20]), drawn.each(lambda tensor: tensor[20:]))
    assert torch.equal(channels(splat(halves, eye)), channels(splat(drawn, eye)))


def test_a_change_in_place_before_backward_is_noticed() -> None:
    drawn, eye = facing(1)
    own = drawn.each(lambda tensor: tensor.clone().requires_grad_())
    total = splat(own, eye).colour.sum()
    with torch.no_grad():
        own.positions.add_(1.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        total.backward()


def test_arguments_that_do_not_fit_are_refused() -> None:
    drawn, eye = facing(2)
    with pytest.raises(TypeError, match="expected float32 on the CPU"):
        splat(drawn.each(torch.Tensor.double), eye)
    with pytest.raises(ValueError, match=r"screen_offsets: have shape \(3, 2\); expected \(2, 2\)"):
        splat(drawn, eye, screen_offsets=torch.zeros(3, 2))
    with pytest.raises(ValueError, match=r"background: has shape \(4,\); expected \(3,\) or \(21, 21, 3\)"):
        splat(drawn, eye, background=torch.zeros(4))
    with pytest.raises(ValueError, match="threads: 0"):
        splat(drawn, eye, threads=0)
    with pytest.raises(ValueError, match="expected both above zero"):
        splat(drawn, eye, optics=Optics(blur=0.0))
    with pytest.raises(ValueError, match=r"rotations: have shape \(2, 3\); expected \(2, 4\)"):
        dataclasses.replace(drawn, rotations=torch.zeros(2, 3))
    with pytest.raises(ValueError, match="harmonics: have shape"):
        dataclasses.replace(drawn, harmonics=torch.zeros(2, 5, 3))
