"""A network for what a simulation lacks: an acceleration of every carrier by its place and state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

# Numbers that each carrier shows, and units of the two layers between.
INPUTS, HIDDEN = 15, 24
# Carriers nearer than this many spacings are surroundings.
NEAR = 1.8
NAMES = ("weight0", "bias0", "weight1", "bias1", "weight2", "bias2")
SHAPES = ((HIDDEN, INPUTS), (HIDDEN,), (HIDDEN, HIDDEN), (HIDDEN,), (3, HIDDEN), (3,))


def starting_weights(seed: int) -> dict[str, np.ndarray]:
    """Weights by name of a network that says nothing yet: those of its last layer are zero."""
    generator = np.random.default_rng(seed)
    out = {}
    for name, shape in zip(NAMES, SHAPES, strict=True):
        size = generator.standard_normal(shape) / np.sqrt(shape[-1])
        out[name] = np.zeros(shape) if name in ("bias0", "bias1", "weight2", "bias2") else size
    return out


@dataclass(frozen=True)
class Scales:
    """What of each input and of the output counts as one. place: [m] from middle; displacement [m]; velocity
    [m/s]; of differences to the surroundings: the same two; acceleration [m/s^2]; spacing: of the grid that
    differences were taken on [m]."""

    middle: tuple[float, float, float]
    place: float
    displacement: float
    velocity: float
    displacement_near: float
    velocity_near: float
    acceleration: float
    spacing: float

    @classmethod
    def of(cls, numbers: np.ndarray) -> Scales:
        """From (10,) numbers, as `numbers` gives them."""
        values = [float(x) for x in numbers]
        return cls(tuple(values[:3]), *values[3:])

    @property
    def numbers(self) -> np.ndarray:
        """(10,) all of them."""
        return np.array(
            [
                *self.middle, self.place, self.displacement, self.velocity, self.displacement_near,
                self.velocity_near, self.acceleration, self.spacing,
            ]
        )  # fmt: skip


class Surroundings:
    """Of every carrier the mean over those near it, by their mass."""

    def __init__(self, rest: np.ndarray, mass: np.ndarray, spacing: float) -> None:
        """rest: (N, 3) [m]; mass: (N,) [kg]; spacing: of the grid [m]."""
        pairs = cKDTree(rest).sparse_distance_matrix(cKDTree(rest), NEAR * spacing, output_type="ndarray")
        weight = mass[pairs["j"]]
        total = np.bincount(pairs["i"], weight, minlength=len(rest))
        self._own, self._other = (torch.from_numpy(pairs[k].astype(np.int64)) for k in "ij")
        self._share = torch.from_numpy(weight / total[pairs["i"]])[:, None]
        self._spacing = spacing

    def apart(self, field: Tensor, spacing: float) -> Tensor:
        """A field (N, 3) less its mean near by, as if the grid had that spacing [m]: it grows with the
        spacing's square."""
        near = self._share.to(field.dtype) * field[self._other]
        mean = torch.zeros_like(field).index_add(0, self._own, near)
        return (field - mean) * (spacing / self._spacing) ** 2


def acceleration(
    weights: Mapping[str, Tensor] | Sequence[Tensor],
    scales: Scales,
    near: Surroundings,
    rest: Tensor,
    displacement: Tensor,
    velocity: Tensor,
) -> Tensor:
    """(N, 3) [m/s^2]. rest: (N, 3) [m]; displacement: from the rigid motion of what holds the object [m];
    velocity: (N, 3) [m/s]."""
    w0, b0, w1, b1, w2, b2 = (weights[name] for name in NAMES)
    middle = torch.tensor(scales.middle, dtype=rest.dtype)
    shown = [
        (rest - middle) / scales.place,
        displacement / scales.displacement,
        velocity / scales.velocity,
        near.apart(displacement, scales.spacing) / scales.displacement_near,
        near.apart(velocity, scales.spacing) / scales.velocity_near,
    ]
    # Carriers at the fringe may do what no material does: they do not decide.
    x = torch.cat([torch.clamp(part, -4.0, 4.0) for part in shown], dim=1).to(w0.dtype)
    x = torch.tanh(x @ w0.T + b0)
    x = torch.tanh(x @ w1.T + b1)
    return scales.acceleration * (x @ w2.T + b2)
