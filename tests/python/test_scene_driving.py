"""Gaussians follow their particles; the polar rotation has the right derivative, at rest as well."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from gaussian_example import gaussians
from mphygs.capture.rotation import matrix_from_rotation_vector, quaternion_from_matrix
from mphygs.scene.driving import bind, driven
from mphygs.scene.tensor_rotation import (
    polar_rotation,
    quaternion_product,
    quaternions_of_rotations,
    rotation_matrices,
)


def turns(count: int, seed: int = 0, size: float = 2.0) -> torch.Tensor:
    return torch.from_numpy(
        matrix_from_rotation_vector(size * np.random.default_rng(seed).normal(size=(count, 3)))
    )


def test_polar_rotation() -> None:
    rotation = turns(20)
    draw = torch.randn(20, 3, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    stretch = torch.eye(3, dtype=torch.float64) + 0.3 * draw @ draw.mT
    torch.testing.assert_close(polar_rotation(rotation @ stretch), rotation)
    inverted = torch.diag(torch.tensor([1.0, 0.8, -0.1], dtype=torch.float64))
    assert torch.det(polar_rotation(inverted)).item() == pytest.approx(1.0)


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
def test_polar_rotation_can_be_differentiated() -> None:
    rest = torch.eye(3, dtype=torch.float64).repeat(2, 1, 1)
    rest[1] = turns(1)[0] @ torch.tensor(
        [[1.2, 0.1, 0.0], [0.1, 0.9, 0.2], [0.0, 0.2, 1.0]], dtype=torch.float64
    )
    assert torch.autograd.gradcheck(polar_rotation, rest.requires_grad_(), check_forward_ad=True)


def test_quaternions_of_rotations() -> None:
    matrices = torch.cat(
        [turns(50), torch.diag_embed(torch.tensor([[-1.0, -1.0, 1.0], [1.0, -1.0, -1.0]]).double())]
    )
    quaternions = quaternions_of_rotations(matrices)
    torch.testing.assert_close(rotation_matrices(quaternions), matrices)
    expected = torch.from_numpy(quaternion_from_matrix(matrices.numpy()))
    assert torch.allclose((quaternions * expected).sum(-1).abs(), torch.ones(52).double())
    product = rotation_matrices(quaternion_product(quaternions[:20], quaternions[20:40]))
    torch.testing.assert_close(product, matrices[:20] @ matrices[20:40])


def lattice() -> torch.Tensor:
    axis = torch.linspace(-0.15, 0.15, 7, dtype=torch.float64)
    return torch.stack(torch.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)


def test_gaussians_follow_an_affine_motion_exactly() -> None:
    drawn, rest = gaussians(40), lattice()
    binding = bind(drawn, rest)
    torch.testing.assert_close(binding.weights.sum(1), torch.ones(40, dtype=torch.float64))
    rotation = turns(1, seed=3)[0]
    motion = rotation @ torch.tensor(
        [[1.1, 0.05, 0.0], [0.05, 0.95, 0.0], [0.0, 0.0, 1.0]], dtype=torch.float64
    )
    shift = torch.tensor([0.2, -0.1, 0.3], dtype=torch.float64)
    moved = driven(drawn, binding, rest @ motion.T + shift, motion.repeat(len(rest), 1, 1))
    torch.testing.assert_close(moved.positions, drawn.positions @ motion.T + shift)
    torch.testing.assert_close(
        rotation_matrices(moved.rotations), rotation @ rotation_matrices(drawn.rotations)
    )
    assert moved.scales is drawn.scales and moved.harmonics is drawn.harmonics


def test_nearest_particles_lead() -> None:
    drawn = gaussians(2)
    drawn.positions[:] = torch.tensor([[0.001, 0.0, 0.0], [0.1, 0.0, 0.0]])
    rest = torch.tensor([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], dtype=torch.float64)
    binding = bind(drawn, rest, neighbours=2)
    assert binding.neighbours.tolist() == [[0, 1], [1, 0]] and (binding.weights[:, 0] > 0.99).all()
    still = torch.eye(3, dtype=torch.float64).repeat(2, 1, 1)
    moved = driven(drawn, binding, rest + torch.tensor([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), still)
    assert moved.positions[0, 1].abs() < 0.01 and moved.positions[1, 1] > 0.99
    with pytest.raises(ValueError, match="neighbours: 3 of 2 particles"):
        bind(drawn, rest, neighbours=3)


def test_driving_can_be_differentiated() -> None:
    drawn, rest = gaussians(3), lattice()[::20]
    binding = bind(drawn, rest, neighbours=3)
    deformation = turns(len(rest), size=0.2)

    def moved(positions: torch.Tensor, gradients: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        result = driven(drawn, binding, positions, gradients)
        return result.positions, result.rotations

    assert torch.autograd.gradcheck(moved, (rest.clone().requires_grad_(), deformation.requires_grad_()))
