"""A mixture of laws of elasticity at every point: what of it the core's law says, and the rest as a stress.

The core's fixed corotated law is W = mu |F - R|^2 + lambda / 2 (J - 1)^2, whose second term alone is another
law; so by its mu and lambda at every point it carries two of the mixture, and rotations are left to it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

# Fixed corotated; against a change of volume alone; neo-Hookean; Saint Venant-Kirchhoff.
CORE_LAW = "fixed-corotated"
LAWS = (CORE_LAW, "dilation", "neo-hookean", "saint-venant-kirchhoff")
# Of a matrix (9, ...), the entries one or two rows and columns on, which a cofactor is made of.
_ROW, _COLUMN = np.divmod(np.arange(9), 3)
_ON = {(r, c): 3 * ((_ROW + r) % 3) + (_COLUMN + c) % 3 for r in (1, 2) for c in (1, 2)}


def strengths_of(weights: np.ndarray, level: np.ndarray) -> np.ndarray:
    """(G, K) stiffness of every law in every group over the usual, of weights (G, K) and a level (1,): the
    stiffness of the object in logarithms, of which each law has its share by a softmax of the weights."""
    raised = np.exp(weights - weights.max(1, keepdims=True))
    return np.exp(level[0]) * raised / raised.sum(1, keepdims=True)


def slopes_of(strengths: np.ndarray, bar: np.ndarray) -> dict[str, np.ndarray]:
    """Derivative of a loss by `weights` and `level`, for that by the strengths (G, K)."""
    moved = strengths * bar
    share = strengths / strengths.sum(1, keepdims=True)
    return {"weights": moved - share * moved.sum(1, keepdims=True), "level": np.array([moved.sum()])}


def core_fields(strengths: np.ndarray, mu: np.ndarray, lambda_: np.ndarray) -> dict[str, np.ndarray]:
    """Lame's parameters of the core's law, for the usual ones, all of one shape (...), and strengths
    (..., K) there."""
    return {"mu": strengths[..., 0] * mu, "lambda": (strengths[..., 0] + strengths[..., 1]) * lambda_}


def core_bar(bars: Mapping[str, np.ndarray], mu: np.ndarray, lambda_: np.ndarray) -> np.ndarray:
    """(..., 2) derivative of a loss by the strengths of the core's two laws, for that by its fields."""
    by_mu, by_lambda = (bars[name].reshape(mu.shape) for name in ("mu", "lambda"))
    return np.stack([by_mu * mu + by_lambda * lambda_, by_lambda * lambda_], axis=-1)


class MixtureStress:
    """What the core's law does not say of a mixture, in a rollout; see PointHook of the core.

    Neo-Hookean, W = mu / 2 (|F|^2 - 3) - mu ln J + lambda / 2 (ln J)^2, and Saint Venant-Kirchhoff,
    W = mu |G|^2 + lambda / 2 (tr G)^2 with G = (F^T F - I) / 2, each by its strength. Both together are
    P = a F + b cof F + mu' F F^T F with numbers a and b at every point.

    strengths: (G, K) of all laws; group: (N,) of every point; mu, lambda_: (N,) [Pa], the usual. After an
    adjoint run `bar` (G, 2) holds the derivative by its own strengths.
    """

    def __init__(
        self, strengths: np.ndarray, group: np.ndarray, mu: np.ndarray, lambda_: np.ndarray, dtype: type
    ) -> None:
        self._usual = mu.astype(dtype), lambda_.astype(dtype)
        own = strengths[group, 2:].astype(dtype).T
        (self._mu, self._mu2), (self._lambda, self._lambda2) = (own * usual for usual in self._usual)
        self._group = group
        self.bar = np.zeros((len(strengths), 2))

    def forward(
        self,
        first_direction: int,
        time: float,
        position: np.ndarray,
        velocity: np.ndarray,
        deformation: np.ndarray,
    ) -> tuple[None, np.ndarray]:
        """No force, and first Piola-Kirchhoff stress (1, N, 3, 3) [Pa], of deformations (1, N, 3, 3)."""
        if len(deformation) != 1:
            raise ValueError("a mixture of laws: expected a run without tangents")
        f = _entries(deformation)
        c = _cofactor(f)
        j = (f[:3] * c[:3]).sum(0)
        a = self._mu - self._mu2 + 0.5 * self._lambda2 * ((f * f).sum(0) - 3.0)
        b = (self._lambda * np.log(j) - self._mu) / j
        return None, _points(a * f + b * c + self._mu2 * _product(_left(f, f), f), deformation)

    def reverse(
        self,
        time: float,
        position: np.ndarray,
        velocity: np.ndarray,
        deformation: np.ndarray,
        force_bar: None,
        stress_bar: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bars of position, velocity and deformation; that of the strengths is added up here.

        A stress that is the slope of an energy has a symmetric derivative: its transpose is the change of the
        stress along the bar.
        """
        f, d = _entries(deformation), _entries(stress_bar)
        c = _cofactor(f)
        j, squares = (f[:3] * c[:3]).sum(0), (f * f).sum(0) - 3.0
        log_j = np.log(j)
        along, volumetric = (f * d).sum(0), (c * d).sum(0) / j
        left, mixed = _left(f, f), _left(f, d)
        a = self._mu - self._mu2 + 0.5 * self._lambda2 * squares
        b = (self._lambda * log_j - self._mu) / j
        db = self._lambda * volumetric / j - b * volumetric
        both = mixed + mixed.reshape(3, 3, -1).swapaxes(0, 1).reshape(9, -1)
        change = a * d + self._lambda2 * along * f + b * _cofactor_change(f, d) + db * c
        change += self._mu2 * (_product(both, f) + _product(left, d))
        mu, lambda_ = self._usual
        told = (
            mu * (along - volumetric) + lambda_ * log_j * volumetric,
            mu * ((left * mixed).sum(0) - along) + 0.5 * lambda_ * squares * along,
        )
        for k, own in enumerate(told):
            self.bar[:, k] += np.bincount(self._group, own, minlength=len(self.bar))
        return np.zeros_like(position[0]), np.zeros_like(velocity[0]), _points(change, deformation)[0]


def _entries(matrices: np.ndarray) -> np.ndarray:
    """(9, N) of (1, N, 3, 3)."""
    return np.ascontiguousarray(matrices.reshape(-1, 9).T)


def _points(entries: np.ndarray, like: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(entries.T).reshape(like.shape)


def _cofactor(f: np.ndarray) -> np.ndarray:
    return f[_ON[1, 1]] * f[_ON[2, 2]] - f[_ON[1, 2]] * f[_ON[2, 1]]


def _cofactor_change(f: np.ndarray, d: np.ndarray) -> np.ndarray:
    found = d[_ON[1, 1]] * f[_ON[2, 2]] - d[_ON[1, 2]] * f[_ON[2, 1]]
    return found + f[_ON[1, 1]] * d[_ON[2, 2]] - f[_ON[1, 2]] * d[_ON[2, 1]]


def _left(f: np.ndarray, d: np.ndarray) -> np.ndarray:
    """F D^T."""
    return np.einsum("ikn,jkn->ijn", f.reshape(3, 3, -1), d.reshape(3, 3, -1)).reshape(9, -1)


def _product(f: np.ndarray, d: np.ndarray) -> np.ndarray:
    """F D."""
    return np.einsum("ikn,kjn->ijn", f.reshape(3, 3, -1), d.reshape(3, 3, -1)).reshape(9, -1)
