"""How a simulation is run, and what each transfer cannot do."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from mphygs.model.registry import effects

TOTAL_LAGRANGIAN, MLS = "total-lagrangian", "mls"
TRANSFERS = (TOTAL_LAGRANGIAN, MLS)
EXPLICIT, IMPLICIT, AUTO = "explicit", "implicit", "auto"
INTEGRATORS = (EXPLICIT, IMPLICIT, AUTO)


def available_cores() -> int:
    """Cores that this process may run on."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on every system
    return len(affinity(0)) if affinity else os.cpu_count() or 1


@dataclass(frozen=True)
class Settings:
    """How a simulation is run. spacing: [m]; safety: share of the stable substep that is used;
    workers: cores to use, for runs side by side or one run's work; dtype: "float32" or "float64";
    memory_budget: of the adjoint [byte]; transfer: how particles and grid exchange momentum,
    "total-lagrangian" or "mls"; integrator: "explicit" steps as short as stability asks for, "implicit" ones
    as long as accuracy allows, or "auto", whichever cost less."""

    spacing: float
    safety: float = 0.85
    workers: int = field(default_factory=available_cores)
    dtype: str = "float32"
    memory_budget: int = 2 << 30
    transfer: str = TOTAL_LAGRANGIAN
    integrator: str = EXPLICIT

    @property
    def number(self) -> type:
        """The core's type of numbers. Raises ValueError for an unknown dtype."""
        if self.dtype not in ("float32", "float64"):
            raise ValueError(f"dtype '{self.dtype}': expected float32 or float64")
        return np.float32 if self.dtype == "float32" else np.float64


def check_integrator(transfer: str, integrator: str) -> None:
    """Raises ValueError, one line, for an integrator that there is not, or not with the transfer."""
    if integrator not in INTEGRATORS:
        raise ValueError(f"integrator '{integrator}': expected one of {', '.join(INTEGRATORS)}")
    if integrator == IMPLICIT and transfer == MLS:
        raise ValueError(
            f"integrator '{IMPLICIT}': not with --transfer {MLS}; expected --transfer {TOTAL_LAGRANGIAN}"
        )


def impossible_effects(transfer: str) -> dict[str, str]:
    """Effects that a transfer cannot have, each with the reason."""
    if transfer != MLS:
        return {}
    return {name: spec.not_with_mls for name, spec in effects().items() if spec.not_with_mls}


def check_effects(transfer: str, names: Iterable[str]) -> None:
    """Raises ValueError, one line, for an effect that the transfer cannot have."""
    refused = impossible_effects(transfer)
    for name in names:
        if name in refused:
            raise ValueError(
                f"effect '{name}': not with --transfer {transfer}, for {refused[name]}; "
                f"expected --transfer {TOTAL_LAGRANGIAN}"
            )
