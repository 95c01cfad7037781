"""Gaussians as an optimiser sees them: numbers without bounds, with Adam's memory of each."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from mphygs.scene.gaussians import HARMONIC_COUNTS, Gaussians

NAMES = ("positions", "rotations", "log_scales", "logit_opacities", "constant", "harmonics", "features")
_FIRST_DECAY, _SECOND_DECAY, _SMALL = 0.9, 0.999, 1e-15  # as in 3DGS
_LOGIT_LIMIT = 1e-4


class RawGaussians:
    """Unbounded parameters of N Gaussians, which Adam (Kingma and Ba 2015) improves.

    Rows can be kept, copied or added between steps; a new row has no memory. `constant` is the harmonic of
    degree 0, `harmonics` those above it.
    """

    def __init__(self, gaussians: Gaussians) -> None:
        opacities = gaussians.opacities.clamp(_LOGIT_LIMIT, 1 - _LOGIT_LIMIT)
        values = (
            gaussians.positions,
            gaussians.rotations,
            gaussians.scales.log(),
            torch.logit(opacities),
            gaussians.harmonics[:, :1],
            gaussians.harmonics[:, 1:],
            gaussians.features,
        )
        self.values: dict[str, Tensor] = {
            name: value.detach().clone().requires_grad_() for name, value in zip(NAMES, values, strict=True)
        }
        self._first = {name: torch.zeros_like(value) for name, value in self.values.items()}
        self._second = {name: torch.zeros_like(value) for name, value in self.values.items()}
        self._steps = 0

    @property
    def count(self) -> int:
        """Number of Gaussians."""
        return len(self.values["positions"])

    def gaussians(self) -> Gaussians:
        """The Gaussians, whose gradients flow back to the parameters."""
        v = self.values
        return Gaussians(
            positions=v["positions"],
            rotations=v["rotations"],
            scales=v["log_scales"].exp(),
            opacities=torch.sigmoid(v["logit_opacities"]),
            harmonics=torch.cat([v["constant"], v["harmonics"]], dim=1),
            features=v["features"],
        )

    def step(self, rates: Mapping[str, float]) -> None:
        """One step of Adam with the gradients that backward left, and forget them. rates: one per name."""
        self._steps += 1
        first_share = 1 - _FIRST_DECAY**self._steps
        second_share = 1 - _SECOND_DECAY**self._steps
        with torch.no_grad():
            for name, value in self.values.items():
                if value.grad is None or value.numel() == 0:
                    continue
                first, second = self._first[name], self._second[name]
                first.lerp_(value.grad, 1 - _FIRST_DECAY)
                second.mul_(_SECOND_DECAY).addcmul_(value.grad, value.grad, value=1 - _SECOND_DECAY)
                spread = second.div(second_share).sqrt_().add_(_SMALL)
                value.addcdiv_(first, spread, value=-rates[name] / first_share)
                value.grad = None

    def rebuild(self, kept: Tensor, added: Mapping[str, Tensor] | None = None) -> None:
        """Keep the rows `kept` (indices or mask), with their memory, and append the rows `added` without."""
        for name, value in self.values.items():
            parts = [value.detach()[kept]]
            fresh = added[name].detach() if added is not None else value.detach()[:0]
            self.values[name] = torch.cat([*parts, fresh]).requires_grad_()
            for memory in (self._first, self._second):
                memory[name] = torch.cat([memory[name][kept], torch.zeros_like(fresh)])

    def raise_degree(self) -> None:
        """One more degree of harmonics, at most three, its coefficients zero."""
        count = 1 + self.values["harmonics"].shape[1]
        degree = HARMONIC_COUNTS.index(count)
        if degree == len(HARMONIC_COUNTS) - 1:
            return
        more = HARMONIC_COUNTS[degree + 1] - count
        value = self.values["harmonics"].detach()
        zeros = value.new_zeros(len(value), more, 3)
        self.values["harmonics"] = torch.cat([value, zeros], dim=1).requires_grad_()
        for memory in (self._first, self._second):
            memory["harmonics"] = torch.cat([memory["harmonics"], zeros.clone()], dim=1)
