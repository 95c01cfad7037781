"""Elastic constants."""

from __future__ import annotations

import numpy as np


def lame(youngs_modulus: np.ndarray, poissons_ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lame's parameters mu, lambda [Pa] of Young's modulus [Pa] and Poisson's ratio [-]."""
    mu = youngs_modulus / (2.0 * (1.0 + poissons_ratio))
    return mu, youngs_modulus * poissons_ratio / ((1.0 + poissons_ratio) * (1.0 - 2.0 * poissons_ratio))


def lame_by_poissons_ratio(
    youngs_modulus: np.ndarray, poissons_ratio: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives of mu and lambda by Poisson's ratio [Pa]."""
    nu = poissons_ratio
    d_mu = -youngs_modulus / (2.0 * (1.0 + nu) ** 2)
    product = (1.0 + nu) * (1.0 - 2.0 * nu)
    d_lambda = youngs_modulus * (product + nu * (1.0 + 4.0 * nu)) / product**2
    return d_mu, d_lambda
