"""What a rollout runs: windows, effects in Python, and which tensor is which field of which window."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from torch import Tensor

from mphygs.simulate.body import Body
from mphygs.simulate.observer import Observer
from mphygs.simulate.user_forces import UserForces

FIELD_NAMES = (
    "mu", "lambda", "stress_volume", "mass", "deformation0", "effect", "place_mass", "place_effect",
    "gravity", "displacement0", "velocity0", "node_force", "pose", "target", "channel",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Window:
    """One stretch of time. schedule: {"steps": (F,), "dt": (F,) [s], "start": [s]}.

    fields: tensors of this window alone; they take the place of shared ones of the same name; observer:
    feedback towards the field `target`, (F, M, 4, 3) [m] cubic polynomials in the share of each of F
    intervals, for each of the observer's M channels; None for a free run, which has no such field.
    """

    schedule: Mapping[str, object]
    fields: Mapping[str, Tensor] = field(default_factory=dict)
    observer: Observer | None = None


@dataclass(frozen=True, eq=False)
class UserTerms:
    """Effects in Python that a rollout includes.

    names: registered effects; parameters: (Q,) their values, one effect after the other; body: the object
    that the model was built from.
    """

    names: tuple[str, ...]
    parameters: Tensor
    body: Body


@dataclass(frozen=True, eq=False)
class Plan:
    """What of a call is not a tensor. slots: per window, field name -> index among the tensors; with effects
    in Python the last tensor holds their parameters."""

    model: object
    schedules: tuple[dict, ...]
    slots: tuple[dict[str, int], ...]
    observers: tuple[Observer | None, ...]
    workers: int
    user_names: tuple[str, ...] = ()
    user_body: Body | None = None

    def hook(
        self,
        window: int,
        arrays: Sequence[np.ndarray],
        directions: Sequence[Sequence[np.ndarray | None]] = (),
    ) -> UserForces | None:
        if self.user_body is None:
            return None
        mass = self.slots[window]["mass"]
        zero = np.zeros_like(arrays[-1])
        return UserForces(
            self.user_names, arrays[-1], mass=arrays[mass], body=self.user_body, dtype=arrays[-1].dtype.type,
            directions=[(zero if d[-1] is None else d[-1], d[mass]) for d in directions],
        )  # fmt: skip

    def fields(self, window: int, arrays: Sequence[np.ndarray | None]) -> dict[str, np.ndarray]:
        return {name: arrays[i] for name, i in self.slots[window].items() if arrays[i] is not None}

    def each(self, work: Callable[[int], object]) -> list:
        """work(window) for every window; results in order. The core leaves the interpreter free meanwhile."""
        windows = range(len(self.schedules))
        if self.workers == 1 or len(windows) == 1:
            return [work(w) for w in windows]
        with ThreadPoolExecutor(min(self.workers, len(windows))) as pool:
            return list(pool.map(work, windows))
