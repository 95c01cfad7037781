"""The object at rest from dense views: its optimiser, its changes of density, and the whole."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gaussian_example import gaussians
from mesh_picture import cameras_around, draw_mesh, dumbbell
from mphygs.capture.cameras import Camera
from mphygs.capture.errors import CaptureError
from mphygs.capture.views import Photograph
from mphygs.render.density_control import DensityControl, DensityRule
from mphygs.render.gaussian_reconstruction import ReconstructionSettings, reconstruct
from mphygs.render.image_metrics import image_metrics
from mphygs.render.raw_gaussians import NAMES, RawGaussians
from mphygs.render.splatting import splat
from mphygs.scene.gaussians import Gaussians


def small(count: int = 6, degree: int = 1) -> Gaussians:
    return gaussians(count, degree=degree).each(torch.Tensor.float)


def set_gradients(raw: RawGaussians, seed: int) -> None:
    draw = torch.Generator().manual_seed(seed)
    for value in raw.values.values():
        value.grad = torch.randn(value.shape, generator=draw)


def test_raw_gaussians_are_the_same_gaussians() -> None:
    drawn = small()
    for have, want in zip(RawGaussians(drawn).gaussians().tensors(), drawn.tensors(), strict=True):
        torch.testing.assert_close(have, want)


def test_steps_are_those_of_adam() -> None:
    raw = RawGaussians(small())
    rates = {name: 0.01 * (index + 1) for index, name in enumerate(NAMES)}
    copies = {name: value.detach().clone().requires_grad_() for name, value in raw.values.items()}
    adam = torch.optim.Adam([{"params": [copies[name]], "lr": rates[name]} for name in NAMES], eps=1e-15)
    for step in range(5):
        set_gradients(raw, step)
        for name, copy in copies.items():
            copy.grad = raw.values[name].grad.clone()
        raw.step(rates)
        adam.step()
    for name, copy in copies.items():
        torch.testing.assert_close(raw.values[name], copy, msg=name)
        assert raw.values[name].grad is None


def test_rows_keep_their_memory() -> None:
    """Rows that stay move on as before; rows that are new begin afresh."""
    rates = dict.fromkeys(NAMES, 0.01)
    whole, part = RawGaussians(small()), RawGaussians(small())
    for raw in (whole, part):
        set_gradients(raw, 0)
        raw.step(rates)
    kept = torch.tensor([4, 1])
    part.rebuild(kept, {name: value[:1] for name, value in part.values.items()})
    assert part.count == 3
    set_gradients(whole, 1)
    for name, value in part.values.items():
        value.grad = whole.values[name].grad[[4, 1, 0]].clone()
    whole.step(rates)
    part.step(rates)
    for name in NAMES:
        torch.testing.assert_close(part.values[name][:2], whole.values[name][kept], msg=name)
        assert not torch.allclose(part.values[name][2], whole.values[name][0]), name


def test_more_harmonics_change_nothing_at_first() -> None:
    raw = RawGaussians(small(degree=0))
    before = raw.gaussians().harmonics.detach()
    for degree in (1, 2, 3, 3):
        raw.raise_degree()
        assert raw.gaussians().degree == degree
    after = raw.gaussians().harmonics
    torch.testing.assert_close(after[:, :1], before)
    assert not after[:, 1:].any()


def test_density_control_clones_splits_and_prunes() -> None:
    raw = RawGaussians(small(4, degree=0))
    with torch.no_grad():
        # small and coarse; large and coarse; fine; faint
        raw.values["log_scales"][:] = torch.tensor([0.001, 0.05, 0.01, 0.01]).log()[:, None]
        raw.values["logit_opacities"][:] = torch.tensor([0.0, 0.0, 0.0, -9.0])
    before = {name: value.detach().clone() for name, value in raw.values.items()}
    control = DensityControl(DensityRule(), extent=1.0, count=4, seed=0)
    gradient = torch.tensor([[3e-6, 4e-6], [1e-5, 0.0], [1e-7, 0.0], [1.0, 0.0]])
    control.add(gradient, torch.tensor([0, 1, 2, 3]), size=200)
    control.add(gradient, torch.tensor([1, 0, 2]), size=200)
    control.change(raw)
    # the first and the third stay, a copy of the first and two children of the second are new
    torch.testing.assert_close(raw.values["positions"][:3], before["positions"][[0, 2, 0]])
    assert raw.count == 5
    children = raw.values["log_scales"][3:]
    torch.testing.assert_close(children.exp(), torch.full((2, 3), 0.05 / 1.6))
    away = (raw.values["positions"][3:] - before["positions"][1]).norm(dim=1)
    assert (away > 1e-3).all() and (away < 0.25).all()
    control.change(raw)
    assert raw.count == 5, "nothing was gathered since"
    full = DensityControl(DensityRule(most=5), extent=1.0, count=5, seed=0)
    full.add(torch.ones(5, 2), torch.arange(5), size=200)
    full.change(raw)
    assert raw.count == 5, "there is no room"
    with pytest.raises(ValueError, match="expected every number above zero"):
        DensityRule(faint=0.0)


def photographs_of(cameras: list[Camera]) -> list[Photograph]:
    pictures = []
    for camera in cameras:
        colour, coverage = draw_mesh(camera, dumbbell())
        pictures.append(Photograph(camera, colour.astype(np.float32), coverage.astype(np.float32)))
    return pictures


@pytest.fixture(scope="module")
def photographs() -> list[Photograph]:
    return photographs_of(cameras_around(9, 48))


def test_an_object_is_found_from_its_views(photographs: list[Photograph]) -> None:
    calls: list[tuple[int, int, float, int]] = []
    # features that are the picture's own colours: what they become can be checked
    maps = [torch.from_numpy(photograph.colour) for photograph in photographs]
    settings = ReconstructionSettings(iterations=250, hull=28, degree=1)
    found = reconstruct(
        photographs, feature_maps=maps, settings=settings, progress=lambda *state: calls.append(state)
    )
    assert found.losses[-20:].mean() < 0.1 * found.losses[:5].mean()
    assert list(found.metrics) == [photograph.camera.name for photograph in photographs]
    assert np.mean([metrics.psnr for metrics in found.metrics.values()]) > 30
    assert calls[-1][:2] == (250, 250) and 0.9 * calls[-1][3] < found.gaussians.count <= calls[-1][3]
    assert found.gaussians.degree == 1 and not found.gaussians.positions.requires_grad
    # views that it was not made from
    for photograph in photographs_of(cameras_around(3, 48, first=0.4)):
        picture = splat(found.gaussians, photograph.camera)
        metrics = image_metrics(picture, photograph)
        assert metrics.psnr > 28 and metrics.iou > 0.95 and metrics.chamfer_px < 0.1
        error = (picture.features - torch.from_numpy(photograph.colour)).abs().mean().item()
        assert error < 0.03


def test_the_same_seed_gives_the_same_numbers(photographs: list[Photograph]) -> None:
    settings = ReconstructionSettings(iterations=30, hull=20, change_every=10)
    first, second = (reconstruct(photographs[:4], settings=settings) for _ in range(2))
    assert all(
        torch.equal(*pair) for pair in zip(first.gaussians.tensors(), second.gaussians.tensors(), strict=True)
    )


def test_what_is_refused(photographs: list[Photograph]) -> None:
    with pytest.raises(CaptureError, match="rest views: are 2; expected at least 3"):
        reconstruct(photographs[:2])
    with pytest.raises(ValueError, match="1 feature maps; expected"):
        reconstruct(photographs, feature_maps=[torch.zeros(4, 4, 2)])
    with pytest.raises(ValueError, match="degree 4"):
        ReconstructionSettings(degree=4)
