"""One way to run either transfer of the compiled core.

A trajectory is a tuple of arrays with a first axis of output frames, the initial state included:
(displacement, velocity) of the nodes for the total-Lagrangian transfer, (position, velocity, deformation) of
the particles for MLS-MPM, and then the reactions of the holds where the schedule asks for them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from mphygs import _core
from mphygs.simulate.observer import Observer

Arrays = Mapping[str, np.ndarray]
Progress = Callable[[int], bool] | None
# Names of effects that a direction alone has, and the parameters of all core effects.
Apart = tuple[list[str], np.ndarray]

_MLS = (_core.MlsMpmFloat32, _core.MlsMpmFloat64)
NO_HOOK = "effects in Python do not run in MLS-MPM; expected the total-Lagrangian transfer"


def is_mls(model: object) -> bool:
    """Whether a compiled model is one of MLS-MPM."""
    return isinstance(model, _MLS)


def number_of(model: object) -> type:
    """The floating-point type that a model computes in."""
    single = isinstance(model, (_core.MlsMpmFloat32, _core.TotalLagrangianFloat32))
    return np.float32 if single else np.float64


def state_size(model: object) -> int:
    """How many arrays a trajectory of the model has."""
    return 3 if is_mls(model) else 2


def _plain(hook: object | None) -> None:
    if hook is not None:
        raise ValueError(NO_HOOK)


def _given(observer: Observer | None) -> dict[str, object] | None:
    return None if observer is None else observer.as_dict()


def run_core(
    model: object,
    fields: Arrays,
    schedule: Mapping,
    progress: Progress = None,
    hook: object | None = None,
    observer: Observer | None = None,
) -> tuple[np.ndarray, ...]:
    """The trajectory. Raises SimulationError where it is unstable, ValueError for sizes that disagree."""
    if is_mls(model):
        _plain(hook)
        return tuple(model.simulate(fields, schedule, progress, _given(observer)))
    return tuple(model.simulate(fields, schedule, progress, hook, _given(observer)))


def run_core_tangent(
    model: object,
    fields: Arrays,
    directions: Sequence[Arrays],
    schedule: Mapping,
    progress: Progress = None,
    hook: object | None = None,
    apart: Sequence[Apart | None] = (),
    observer: Observer | None = None,
) -> list[tuple[np.ndarray, ...]]:
    """The trajectory, and its derivative in each direction.

    apart: effects that each direction has besides the model's own, at their null, None for none; only of the
    total-Lagrangian transfer.
    """
    if is_mls(model):
        _plain(hook)
        runs = model.tangent(fields, list(directions), schedule, progress, _given(observer))
        return [tuple(t) for t in runs]
    given = (progress, hook, list(apart), _given(observer))
    return [tuple(t) for t in model.tangent(fields, list(directions), schedule, *given)]


def run_core_adjoint(
    model: object,
    fields: Arrays,
    schedule: Mapping,
    bars: Sequence[np.ndarray | None],
    hook: object | None = None,
    observer: Observer | None = None,
) -> dict[str, np.ndarray]:
    """Gradient by every field of a loss whose derivatives by the trajectory are given, None for none."""
    if is_mls(model):
        _plain(hook)
        return model.adjoint(fields, schedule, tuple(bars), None, _given(observer))[0]
    empty = np.zeros(0, number_of(model))
    displacement, velocity, *reaction = (empty if bar is None else bar for bar in bars)
    given = (displacement, velocity, None, hook, _given(observer), *reaction)
    return model.adjoint(fields, schedule, *given)[0]


def run_core_gradient(
    model: object,
    fields: Arrays,
    schedule: Mapping,
    loss: Callable[..., tuple[np.ndarray | None, ...]],
    hook: object | None = None,
) -> dict[str, np.ndarray]:
    """Gradient by every field of a loss whose derivatives `loss` says once it is given the trajectory, array
    by array: one forward run less than that run and its adjoint.

    Raises SimulationError where the run is unstable, and what `loss` raises.
    """
    if is_mls(model):
        _plain(hook)
        return model.gradient(fields, schedule, loss)[0]
    return model.gradient(fields, schedule, loss, None, hook)[0]
