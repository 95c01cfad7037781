"""Spherical harmonics: orthonormal, and with the signs and the order of the original code."""

from __future__ import annotations

import numpy as np
import torch

from gaussian_example import gaussians
from mphygs.render.harmonics import harmonic_basis, seen_colours
from mphygs.scene.gaussians import colour_of_harmonics, harmonics_of_colour
from mphygs.scene.tensor_rotation import rotation_matrices


def test_orthonormal_on_the_sphere() -> None:
    nodes, node_weights = np.polynomial.legendre.leggauss(8)
    turn = np.arange(16) * 2 * np.pi / 16
    z, angle = np.meshgrid(nodes, turn, indexing="ij")
    radius = np.sqrt(1 - z**2)
    directions = torch.from_numpy(
        np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).reshape(-1, 3)
    )
    weights = torch.from_numpy(np.repeat(node_weights, 16) * 2 * np.pi / 16)
    basis = harmonic_basis(directions, 16)
    gram = basis.T @ (weights[:, None] * basis)
    torch.testing.assert_close(gram, torch.eye(16, dtype=torch.float64), atol=1e-6, rtol=0)


def test_signs_and_order() -> None:
    """Which way each harmonic of degree 1 to 3 is positive, from the formulas published with 3DGS."""
    axes = torch.eye(3, dtype=torch.float64)
    basis = harmonic_basis(axes, 16)
    torch.testing.assert_close(
        basis[0, [3, 6, 8, 13, 15]].sign(), -torch.tensor([1, 1, -1, -1, 1.0]).double()
    )
    torch.testing.assert_close(basis[1, [1, 6, 8, 9, 11]].sign(), -torch.tensor([1, 1, 1, -1, -1.0]).double())
    torch.testing.assert_close(basis[2, [2, 6, 12]].sign(), torch.tensor([1, 1, 1.0]).double())
    corner = harmonic_basis(torch.full((1, 3), 3**-0.5, dtype=torch.float64), 16)[0]
    torch.testing.assert_close(corner[[4, 5, 7, 10]].sign(), torch.tensor([1, -1, -1, 1.0]).double())


def test_colour_and_back() -> None:
    colours = torch.rand(5, 3, generator=torch.Generator().manual_seed(0))
    harmonics = harmonics_of_colour(colours, degree=2)
    assert harmonics.shape == (5, 9, 3)
    torch.testing.assert_close(colour_of_harmonics(harmonics), colours)
    seen = seen_colours(harmonics, torch.randn(5, 3), torch.full((3,), 4.0))
    torch.testing.assert_close(seen, colours)


def test_rotation_matrices_agree_with_the_captures() -> None:
    from mphygs.capture.rotation import matrix_from_quaternion

    rotations = gaussians(9).rotations
    expected = torch.from_numpy(matrix_from_quaternion(rotations.numpy()))
    torch.testing.assert_close(rotation_matrices(rotations), expected)
