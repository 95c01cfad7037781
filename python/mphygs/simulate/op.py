"""The rollout as a torch operation: backward by the checkpointed adjoint, forward mode by tangents.

One call runs several temporal windows side by side. What all windows share (materials, effects) is given
once and its gradient is the sum over the windows; what a window has of its own (initial state, poses, known
forces, feedback and its targets) is given with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from mphygs.simulate import core_runs
from mphygs.simulate.observer import Observer
from mphygs.simulate.rollout_plan import FIELD_NAMES, Plan, UserTerms, Window
from mphygs.simulate.user_forces import UserForces

NO_SECOND_DERIVATIVE = (
    "a rollout has first derivatives only: expected backward() without create_graph, one forward level"
)
NO_BATCHED_INPUTS = "vmap over the inputs of a rollout: expected windows in one call instead"

# Displacement and velocity of nodes, or position, velocity and deformation of particles.
States = tuple[Tensor, ...]


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().contiguous().numpy()


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(plan: Plan, *tensors: Tensor) -> tuple[Tensor, ...]:
        arrays = [_array(t) for t in tensors]
        runs = plan.each(
            lambda w: core_runs.run_core(
                plan.model,
                plan.fields(w, arrays),
                plan.schedules[w],
                hook=plan.hook(w, arrays),
                observer=plan.observers[w],
            )
        )
        return tuple(torch.from_numpy(a) for run in runs for a in run)

    @staticmethod
    def setup_context(ctx: object, inputs: tuple, output: tuple[Tensor, ...]) -> None:
        ctx.plan = inputs[0]
        ctx.save_for_backward(*inputs[1:])
        ctx.save_for_forward(*inputs[1:])
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: object, *bars: Tensor | None) -> tuple[Tensor | None, ...]:
        tensors = ctx.saved_tensors
        wanted = tuple(ctx.needs_input_grad[1:])
        if all(bar is None for bar in bars):
            return (None, *(None for _ in tensors))
        return (None, *_Gradient.apply(ctx.plan, wanted, len(tensors), *tensors, *bars))

    @staticmethod
    def vmap(info: object, in_dims: tuple, plan: Plan, *tensors: Tensor) -> tuple:
        # Inputs that are not batched do not come here; a rollout runs windows, not batches.
        raise NotImplementedError(NO_BATCHED_INPUTS)

    @staticmethod
    def jvp(ctx: object, _plan: None, *tangents: Tensor | None) -> tuple[Tensor, ...]:
        return _Tangent.apply(ctx.plan, len(tangents), *ctx.saved_tensors, *tangents)


class _Gradient(torch.autograd.Function):
    """The adjoint, a function of its own so that a second derivative is refused by name."""

    @staticmethod
    def forward(
        plan: Plan, wanted: tuple[bool, ...], count: int, *tensors: Tensor | None
    ) -> tuple[Tensor | None, ...]:
        inputs, bars = tensors[:count], tensors[count:]
        arrays = [_array(t) for t in inputs]
        size = core_runs.state_size(plan.model)

        def work(window: int) -> tuple[dict[str, np.ndarray], UserForces | None]:
            own = bars[size * window : size * (window + 1)]
            if all(bar is None for bar in own):
                return {}, None
            hook = plan.hook(window, arrays)
            given = [None if bar is None else _array(bar) for bar in own]
            fields, schedule = plan.fields(window, arrays), plan.schedules[window]
            observer = plan.observers[window]
            return core_runs.run_core_adjoint(plan.model, fields, schedule, given, hook, observer), hook

        sums: list[np.ndarray | None] = [
            np.zeros_like(a) if w else None for a, w in zip(arrays, wanted, strict=True)
        ]

        def add(index: int, gradient: np.ndarray) -> None:
            total = sums[index]
            # The core returns nothing for what no active effect reads.
            if total is not None and gradient.size:
                total += gradient.reshape(total.shape).astype(total.dtype, copy=False)

        for slots, (gradient, hook) in zip(plan.slots, plan.each(work), strict=True):
            for name, i in slots.items():
                if name in gradient:
                    add(i, gradient[name])
            if hook is not None:
                add(slots["mass"], hook.mass_bar)
                add(len(arrays) - 1, hook.parameter_bar)
        return tuple(None if s is None else torch.from_numpy(s) for s in sums)

    @staticmethod
    def setup_context(ctx: object, inputs: tuple, output: tuple) -> None:
        pass

    @staticmethod
    def backward(ctx: object, *bars: Tensor) -> tuple:
        raise NotImplementedError(NO_SECOND_DERIVATIVE)

    @staticmethod
    def jvp(ctx: object, *tangents: Tensor) -> tuple:
        raise NotImplementedError(NO_SECOND_DERIVATIVE)


class _Tangent(torch.autograd.Function):
    """The tangent in one direction, or under vmap in all of them in one run."""

    @staticmethod
    def forward(plan: Plan, count: int, *tensors: Tensor | None) -> tuple[Tensor, ...]:
        directions = [[None if t is None else _array(t) for t in tensors[count:]]]
        out = _tangents(plan, [_array(t) for t in tensors[:count]], directions)
        return tuple(torch.from_numpy(a[0]) for a in out)

    @staticmethod
    def setup_context(ctx: object, inputs: tuple, output: tuple) -> None:
        pass

    @staticmethod
    def backward(ctx: object, *bars: Tensor) -> tuple:
        raise NotImplementedError(NO_SECOND_DERIVATIVE)

    @staticmethod
    def jvp(ctx: object, *tangents: Tensor) -> tuple:
        raise NotImplementedError(NO_SECOND_DERIVATIVE)

    @staticmethod
    def vmap(info: object, in_dims: tuple, plan: Plan, count: int, *tensors: Tensor | None) -> tuple:
        dims = in_dims[2:]
        if any(d is not None for d in dims[:count]):
            raise NotImplementedError(NO_BATCHED_INPUTS)
        directions = []
        for k in range(info.batch_size):
            picked = [
                None if t is None else _array(t if d is None else t.select(d, k))
                for t, d in zip(tensors[count:], dims[count:], strict=True)
            ]
            directions.append(picked)
        out = _tangents(plan, [_array(t) for t in tensors[:count]], directions)
        return tuple(torch.from_numpy(a) for a in out), (0,) * len(out)


def _tangents(
    plan: Plan, arrays: list[np.ndarray], directions: list[list[np.ndarray | None]]
) -> list[np.ndarray]:
    """Derivatives of every window's states, each (K, F + 1, N, ...)."""

    def work(window: int) -> list:
        fields = [plan.fields(window, direction) for direction in directions]
        hook = plan.hook(window, arrays, directions)
        own, schedule, observer = plan.fields(window, arrays), plan.schedules[window], plan.observers[window]
        return core_runs.run_core_tangent(plan.model, own, fields, schedule, hook=hook, observer=observer)[1:]

    size = core_runs.state_size(plan.model)
    return [np.stack([tangent[part] for tangent in run]) for run in plan.each(work) for part in range(size)]


def rollout_windows(
    model: object,
    shared: Mapping[str, Tensor],
    windows: Sequence[Window],
    *,
    workers: int = 1,
    user: UserTerms | None = None,
) -> tuple[States, ...]:
    """States of every window at its frames, the initial one included.

    model: a compiled model, which holds the memory budget of the adjoint and how many threads share a run
    (`model.threads`). Of a TotalLagrangianFloat32 or Float64 the states are node displacement (F + 1, N, 3)
    [m] and velocity (F + 1, N, 3) [m/s]; of an MlsMpmFloat32 or Float64 particle position [m], velocity
    [m/s] and deformation (F + 1, N, 3, 3);
    shared: fields of all windows, named as in FIELD_NAMES, in the model's precision; workers: windows run
    side by side; user: effects in Python. Differentiable by every field and by the user's parameters,
    backward and forward; torch.func.jacfwd carries all directions in one run. The result does not depend on
    `workers`, to the bit.

    Raises ValueError for an unknown field, another precision, a wrong size, a target without an observer or
    an observer without its target, effects in Python with MLS-MPM, SimulationError for an unstable run,
    NotImplementedError for second derivatives.
    """
    if not windows:
        raise ValueError("rollout_windows: expected at least one window")
    if workers < 1:
        raise ValueError(f"workers = {workers}: expected at least 1")
    if user is not None and core_runs.is_mls(model):
        raise ValueError(core_runs.NO_HOOK)
    dtype = torch.float32 if core_runs.number_of(model) is np.float32 else torch.float64
    tensors: list[Tensor] = []

    def keep(tensor: Tensor, what: str) -> int:
        if tensor.dtype != dtype or tensor.device.type != "cpu":
            raise ValueError(f"{what} is {tensor.dtype} on {tensor.device}, expected {dtype} on cpu")
        tensors.append(tensor)
        return len(tensors) - 1

    def indices(fields: Mapping[str, Tensor], where: str) -> dict[str, int]:
        found = {}
        for name, tensor in fields.items():
            if name not in FIELD_NAMES:
                raise ValueError(f"{where}: unknown field '{name}', expected one of {', '.join(FIELD_NAMES)}")
            found[name] = keep(tensor, f"{where}: field '{name}'")
        return found

    common = indices(shared, "shared fields")
    slots = tuple(common | indices(window.fields, f"window {k}") for k, window in enumerate(windows))
    schedules = tuple(dict(window.schedule) for window in windows)
    plan = Plan(model, schedules, slots, tuple(window.observer for window in windows), workers)
    if user is not None:
        keep(user.parameters, "the user's parameters")
        plan = replace(plan, user_names=user.names, user_body=user.body)
    out = _Rollout.apply(plan, *tensors)
    size = core_runs.state_size(model)
    return tuple(out[k : k + size] for k in range(0, len(out), size))


def rollout(
    model: object,
    fields: Mapping[str, Tensor],
    schedule: Mapping[str, object],
    *,
    user: UserTerms | None = None,
    observer: Observer | None = None,
) -> States:
    """One window; see `rollout_windows`."""
    return rollout_windows(model, fields, [Window(schedule, observer=observer)], user=user)[0]
