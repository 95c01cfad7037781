"""The stress-free shape as a torch operation, differentiated by the implicit-function theorem."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from mphygs import _core
from mphygs.simulate.op import NO_SECOND_DERIVATIVE

INPUTS = ("mu", "lambda", "effect")


class RestSolver:
    """Solves for the stress-free state of one float64 model and remembers which one the factors belong to.

    Not to be shared between threads.
    """

    def __init__(self, model: object) -> None:
        if not isinstance(model, _core.TotalLagrangianFloat64):
            raise ValueError("a rest shape is solved for in float64: expected a TotalLagrangianFloat64 model")
        self._solver = _core.Equilibrium(model)
        self._at: bytes | None = None
        self._solution: dict | None = None

    def solve(self, arrays: Mapping[str, np.ndarray]) -> dict:
        """Stress-free state for mu, lambda, effect, volume and load; the last map is where Newton starts."""
        signature = b"".join(np.ascontiguousarray(arrays[k]).tobytes() for k in sorted(arrays))
        if signature != self._at:
            fields = {k: arrays[k] for k in INPUTS}
            start = np.zeros(0) if self._solution is None else self._solution["map"]
            self._at = None
            self._solution = self._solver.solve(fields, arrays["volume"], arrays["load"], start)
            self._at = signature
        return self._solution

    def tangent(self, directions: list[tuple[dict, np.ndarray]]) -> list[dict]:
        """Of the last solution; directions: (fields, load) each."""
        return self._solver.tangent(directions)

    def adjoint(self, deformation0_bar: np.ndarray, volume_ratio_bar: np.ndarray) -> tuple[dict, np.ndarray]:
        """Bars of the fields and of the load at the last solution."""
        return self._solver.adjoint(deformation0_bar, volume_ratio_bar)


def _arrays(tensors: tuple[Tensor, ...]) -> dict[str, np.ndarray]:
    return {
        name: t.detach().contiguous().numpy()
        for name, t in zip((*INPUTS, "load", "volume"), tensors, strict=True)
    }


class _Rest(torch.autograd.Function):
    @staticmethod
    def forward(solver: RestSolver, *tensors: Tensor) -> tuple[Tensor, Tensor]:
        solution = solver.solve(_arrays(tensors))
        blocks = tensors[0].shape[0]
        f, ratio = solution["deformation0"], solution["volume_ratio"]
        return torch.from_numpy(f.reshape(blocks, 9, 8).copy()), torch.from_numpy(
            ratio.reshape(blocks, 8).copy()
        )

    @staticmethod
    def setup_context(ctx: object, inputs: tuple, output: tuple) -> None:
        ctx.solver = inputs[0]
        ctx.save_for_backward(*inputs[1:])
        ctx.save_for_forward(*inputs[1:])

    @staticmethod
    def backward(ctx: object, deformation0_bar: Tensor, ratio_bar: Tensor) -> tuple:
        return (
            None,
            *_RestGradient.apply(ctx.solver, deformation0_bar, ratio_bar, *ctx.saved_tensors),
            None,
        )

    @staticmethod
    def jvp(ctx: object, _solver: None, *tangents: Tensor | None) -> tuple[Tensor, Tensor]:
        tensors = ctx.saved_tensors
        ctx.solver.solve(_arrays(tensors))
        blocks = tensors[0].shape[0]
        change = {
            n: t.detach().contiguous().numpy()
            for n, t in zip(INPUTS, tangents, strict=False)
            if t is not None
        }
        load = (
            np.zeros(tuple(tensors[3].shape))
            if tangents[3] is None
            else tangents[3].detach().contiguous().numpy()
        )
        slope = ctx.solver.tangent([(change, load)])[0]
        f, ratio = slope["deformation0"], slope["volume_ratio"]
        return torch.from_numpy(f.reshape(blocks, 9, 8)), torch.from_numpy(ratio.reshape(blocks, 8))


class _RestGradient(torch.autograd.Function):
    @staticmethod
    def forward(solver: RestSolver, deformation0_bar: Tensor, ratio_bar: Tensor, *tensors: Tensor) -> tuple:
        solver.solve(_arrays(tensors))
        fields, load = solver.adjoint(deformation0_bar.contiguous().numpy(), ratio_bar.contiguous().numpy())
        bars = []
        for name, tensor in zip(INPUTS, tensors, strict=False):
            given = fields[name]
            bars.append(
                torch.from_numpy(given).reshape(tensor.shape) if given.size else torch.zeros_like(tensor)
            )
        return (*bars, torch.from_numpy(load).reshape(tensors[3].shape))

    @staticmethod
    def setup_context(ctx: object, inputs: tuple, output: tuple) -> None:
        pass

    @staticmethod
    def backward(ctx: object, *bars: Tensor) -> tuple:
        raise NotImplementedError(NO_SECOND_DERIVATIVE)


def stress_free_state(
    solver: RestSolver, *, mu: Tensor, lame_lambda: Tensor, effect: Tensor, load: Tensor, volume: Tensor
) -> tuple[Tensor, Tensor]:
    """Deformation (B, 9, 8) [-] from the stress-free to the published shape, and volume ratio (B, 8) [-].

    mu, lame_lambda: (B, 8) [Pa]; effect: flat parameters of the core's effects; load: (N, 3) external force
    on the nodes at rest [N]; volume: (B, 8) published volume [m^3]. All float64. Differentiable by mu,
    lame_lambda, effect and load. The rollout takes `deformation0` and `stress_volume` = volume * ratio.

    Raises ValueError where a gradient by the volume is asked for, SimulationError where no stress-free state
    is found.
    """
    if volume.requires_grad:
        raise ValueError(
            "volume: the stress-free state is not differentiated by the published volume, expected a constant"
        )
    tensors = (mu, lame_lambda, effect, load, volume)
    for name, tensor in zip((*INPUTS, "load", "volume"), tensors, strict=True):
        if tensor.dtype != torch.float64:
            raise ValueError(f"{name} is {tensor.dtype}, expected torch.float64")
    return _Rest.apply(solver, *tensors)


def node_mass(model: object, geometry: Mapping[str, object], mass: Tensor) -> Tensor:
    """Lumped mass (N,) [kg] of the nodes of point masses (B, 8) [kg]; differentiable (it is linear).

    geometry: the arrays that the model was built from.
    """
    points = np.asarray(geometry["points"], float).reshape(-1, 3)
    cell = np.repeat(np.asarray(geometry["cell"], np.int32).reshape(-1, 3), 8, axis=0)
    node, value, _ = model.weights(points, cell)
    index = torch.from_numpy(node.astype(np.int64)).reshape(-1)
    share = mass.reshape(-1, 1) * torch.from_numpy(value).to(mass.dtype)
    return torch.zeros(model.node_count, dtype=mass.dtype).index_add(0, index, share.reshape(-1))
