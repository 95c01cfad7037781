"""Effects in Python inside the compiled rollout: called once a substep, for values, tangents and adjoint."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from torch import Tensor

from mphygs.model.belief import Parameter
from mphygs.model.point_state import PointState
from mphygs.model.registry import effect
from mphygs.model.user_effect import UserEffect, implementation, writes
from mphygs.simulate.body import Body
from mphygs.simulate.errors import SimulationError

Direction = tuple[np.ndarray, np.ndarray | None]


class UserForces:
    """The hook that a rollout calls; see PointHook of the core.

    names: the effects; parameters: (Q,) their values, one effect after the other; mass: (N,) [kg];
    directions: change of (parameters, mass or None) in each direction of a tangent run; directions that are
    missing change neither.

    After an adjoint run `parameter_bar` (Q,) and `mass_bar` (N,) hold the gradient by what the core does
    not see.
    """

    def __init__(
        self,
        names: Sequence[str],
        parameters: np.ndarray,
        *,
        mass: np.ndarray,
        body: Body,
        dtype: type,
        directions: Sequence[Direction] = (),
    ) -> None:
        self._effects: tuple[UserEffect, ...] = tuple(implementation(n) for n in names)
        self._names = tuple(names)
        self._keys = [f"{n}.{p.name}" for n in names for p in effect(n).parameters]
        self._dtype = torch.float32 if dtype == np.float32 else torch.float64
        self._parameters = self._tensor(parameters)
        self._mass = self._tensor(mass).reshape(-1)
        self._volume = self._tensor(body.quadrature.volumes).reshape(-1)
        self._part = torch.from_numpy(body.point_part.reshape(-1).astype(np.int64))
        self._directions = [
            (self._tensor(p), torch.zeros_like(self._mass) if m is None else self._tensor(m).reshape(-1))
            for p, m in directions
        ]
        self._forces = any(writes(e, "force") for e in self._effects)
        self._stresses = any(writes(e, "stress") for e in self._effects)
        self.parameter_bar = np.zeros(len(self._parameters))
        self.mass_bar = np.zeros(len(self._mass))

    def slope(self, parameter: Parameter, mass_change: np.ndarray | None) -> float:
        """After an adjoint run: what the core does not see of the slope by a parameter's coordinate."""
        total = (
            0.0
            if mass_change is None
            else float(np.vdot(self.mass_bar, np.asarray(mass_change, float).ravel()))
        )
        if parameter.key in self._keys:
            total += float(self.parameter_bar[self._keys.index(parameter.key)]) * parameter.slope
        return total

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.as_tensor(np.ascontiguousarray(values), dtype=self._dtype)

    def _evaluate(
        self,
        time: float,
        position: Tensor,
        velocity: Tensor,
        deformation: Tensor,
        mass: Tensor,
        parameters: Tensor,
    ) -> tuple[Tensor, ...]:
        """Sum of the forces and sum of the stresses, of those that any effect has."""
        state = PointState(position, velocity, deformation, mass, self._volume, time, self._part)
        force, stress = torch.zeros_like(position), torch.zeros_like(deformation)
        first = 0
        for name, own in zip(self._names, self._effects, strict=True):
            specs = effect(name).parameters
            named = {p.name: parameters[first + k] for k, p in enumerate(specs)}
            first += len(specs)
            if writes(own, "force"):
                given = _called(name, own.force, state, named)
                force = force + _checked(name, "force", given, position)
            else:
                given = _called(name, own.stress, state, named)
                stress = stress + _checked(name, "stress", given, deformation)
        return tuple(t for t, used in ((force, self._forces), (stress, self._stresses)) if used)

    def _named(self, results: Sequence[Tensor]) -> tuple[Tensor | None, Tensor | None]:
        given = iter(results)
        return (next(given) if self._forces else None, next(given) if self._stresses else None)

    def forward(
        self,
        first_direction: int,
        time: float,
        position: np.ndarray,
        velocity: np.ndarray,
        deformation: np.ndarray,
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Force (L, N, 3) [N] and stress (L, N, 3, 3) [Pa] of the value lane and each direction's lane."""
        states = [torch.from_numpy(a) for a in (position, velocity, deformation)]
        inputs = (*(a[0] for a in states), self._mass, self._parameters)
        changes = []
        for lane in range(1, len(position)):
            number = first_direction + lane - 1
            still = (torch.zeros_like(self._parameters), torch.zeros_like(self._mass))
            parameters, mass = self._directions[number] if number < len(self._directions) else still
            changes.append((*(a[lane] for a in states), mass, parameters))
        lanes = self._lanes(time, inputs, changes)
        stacked = [torch.stack(parts).detach().numpy() for parts in zip(*lanes, strict=True)]
        return self._named(stacked)

    def _lanes(
        self, time: float, inputs: Sequence[Tensor], changes: Sequence[Sequence[Tensor]]
    ) -> list[Sequence[Tensor]]:
        """The forces, and their derivative along each change of the inputs.

        J t is the derivative by w of <J^T w, t>: one graph for all directions, and no forward-mode level, of
        which torch allows one at a time (the caller of a rollout may have opened it).
        """
        if not changes:
            with torch.no_grad():
                return [self._evaluate(time, *inputs)]
        with torch.enable_grad():
            leaves = [t.detach().requires_grad_() for t in inputs]
            outputs = self._evaluate(time, *leaves)
            weights = [torch.zeros_like(o, requires_grad=True) for o in outputs]
            moving = [(o, w) for o, w in zip(outputs, weights, strict=True) if o.requires_grad]
            pulled: Sequence[Tensor | None] = [None] * len(leaves)
            if moving:
                moved, by = [o for o, _ in moving], [w for _, w in moving]
                pulled = torch.autograd.grad(moved, leaves, by, create_graph=True, allow_unused=True)
            used = [k for k, p in enumerate(pulled) if p is not None and p.requires_grad]
            reached = [pulled[k] for k in used]
            lanes: list[Sequence[Tensor]] = [outputs]
            for change in changes:
                slopes: Sequence[Tensor | None] = [None] * len(weights)
                if reached:
                    along = [change[k] for k in used]
                    slopes = torch.autograd.grad(
                        reached, weights, along, retain_graph=True, allow_unused=True
                    )
                lanes.append(
                    [torch.zeros_like(w) if g is None else g for w, g in zip(weights, slopes, strict=True)]
                )
        return lanes

    def reverse(
        self,
        time: float,
        position: np.ndarray,
        velocity: np.ndarray,
        deformation: np.ndarray,
        force_bar: np.ndarray | None,
        stress_bar: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bars of position, velocity and deformation; those of parameters and mass are added up here."""
        inputs = [torch.from_numpy(a[0]) for a in (position, velocity, deformation)] + [
            self._mass,
            self._parameters,
        ]
        inputs = [t.detach().requires_grad_() for t in inputs]
        with torch.enable_grad():
            outputs = self._evaluate(time, *inputs)
        bars = [torch.from_numpy(b[0]) for b in (force_bar, stress_bar) if b is not None]
        used = [(o, b) for o, b in zip(outputs, bars, strict=True) if o.requires_grad]
        gradients: Sequence[Tensor | None] = [None] * len(inputs)
        if used:
            gradients = torch.autograd.grad(
                [o for o, _ in used], inputs, [b for _, b in used], allow_unused=True
            )
        full = [torch.zeros_like(t) if g is None else g for t, g in zip(inputs, gradients, strict=True)]
        self.mass_bar += full[3].numpy()
        self.parameter_bar += full[4].numpy()
        return full[0].numpy(), full[1].numpy(), full[2].numpy()


def _called(
    name: str, function: Callable[..., Tensor], state: PointState, parameters: dict[str, Tensor]
) -> Tensor:
    """What a user's function returns. Raises SimulationError where it raises anything."""
    try:
        return function(state, parameters)
    except Exception as error:
        what = " ".join(str(error).split()) or "no more is said"
        raise SimulationError(f"effect '{name}': {type(error).__name__}: {what}") from error


def _checked(name: str, function: str, result: object, like: Tensor) -> Tensor:
    if not isinstance(result, Tensor) or result.shape != like.shape:
        shape = tuple(result.shape) if isinstance(result, Tensor) else type(result).__name__
        raise ValueError(f"effect '{name}': its {function} is {shape}, expected a tensor {tuple(like.shape)}")
    return result
