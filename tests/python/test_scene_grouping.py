"""The grouping losses against sums written out, and as quadratic forms of segments."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from mphygs.scene.grouping import (
    grouping_loss,
    likeness,
    likeness_loss,
    segment_coupling,
    variance_loss,
)


def case(count: int = 30) -> tuple[np.ndarray, torch.Tensor, torch.Tensor]:
    draw = np.random.default_rng(0)
    values = [torch.from_numpy(draw.standard_normal(count)) for _ in range(2)]
    return 0.3 * draw.standard_normal((count, 4)), *values


def test_weights_are_those_of_the_nearest() -> None:
    appearance, _, _ = case()
    alike = likeness(appearance, neighbours=5)
    square = ((appearance[:, None] - appearance) ** 2).sum(-1)
    np.fill_diagonal(square, np.inf)
    for row in range(len(appearance)):
        nearest = np.argsort(square[row])[:5]
        assert set(alike.index[row].tolist()) == set(nearest.tolist())
        weight = np.exp(-20.0 * square[row, alike.index[row]]) + 1e-9
        assert alike.weight[row].numpy() == pytest.approx(weight / weight.sum())
    # equal places: never oneself
    same = likeness(np.zeros((8, 2)), neighbours=3)
    assert (same.index != torch.arange(8)[:, None]).all()
    assert same.weight.numpy() == pytest.approx(1 / 3)
    with pytest.raises(ValueError, match="neighbours: 30 of 30"):
        likeness(appearance, neighbours=30)


def test_losses_are_the_sums_of_the_paper() -> None:
    appearance, modulus, density = case()
    alike = likeness(appearance, neighbours=5)
    expected = 0.0
    for i in range(30):
        for weight, j in zip(alike.weight[i].tolist(), alike.index[i].tolist(), strict=True):
            for values in (modulus, density):
                expected += weight * float(values[i] - values[j]) ** 2 / 30
    assert likeness_loss(modulus, density, alike).item() == pytest.approx(expected)
    spread = float(np.var(modulus.numpy()) + np.var(density.numpy()))
    assert variance_loss(modulus, density).item() == pytest.approx(spread)
    total = grouping_loss(modulus, density, alike, variance_weight=2.0).item()
    assert total == pytest.approx(expected + 2.0 * spread)
    even = torch.ones(30, dtype=torch.float64)
    assert grouping_loss(even, 3.0 * even, alike).item() == pytest.approx(0.0, abs=1e-15)


def test_their_gradient_is_right_and_not_zero() -> None:
    appearance, modulus, density = case(12)
    alike = likeness(appearance, neighbours=4)
    inputs = (modulus.requires_grad_(), density.requires_grad_())
    assert torch.autograd.gradcheck(lambda a, b: grouping_loss(a, b, alike), inputs)
    assert torch.autograd.grad(grouping_loss(*inputs, alike), inputs[0])[0].abs().min() > 1e-6


def test_segments_have_them_as_quadratic_forms() -> None:
    appearance, _, _ = case()
    alike = likeness(appearance, neighbours=6)
    label = np.random.default_rng(1).integers(0, 4, 30)
    pull, spread = segment_coupling(alike, label, 4)
    values = np.array([0.3, -1.0, 2.0, 0.7])
    each, none = torch.from_numpy(values[label]), torch.zeros(30, dtype=torch.float64)
    assert values @ pull @ values == pytest.approx(likeness_loss(each, none, alike).item())
    assert values @ spread @ values == pytest.approx(variance_loss(each, none).item())
    assert np.array_equal(pull, pull.T) and pull @ np.ones(4) == pytest.approx(0.0, abs=1e-12)
