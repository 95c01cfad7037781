"""A user's own effect: a Python class on torch tensors, registered by name."""

from __future__ import annotations

import importlib.util
import logging
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from mphygs.model.descriptor import EffectSpec, ParameterSpec
from mphygs.model.registry import add_user_effect

if TYPE_CHECKING:
    from torch import Tensor

    from mphygs.model.point_state import PointState

KINDS = ("smooth", "threshold")

_IMPLEMENTATIONS: dict[str, UserEffect] = {}


class UserEffect:
    """What an effect's class must have; deriving from this one is allowed, not needed.

    name: as in commands and reports; parameters: its numbers; kind: "smooth", or "threshold" where the
    derivative at the null is zero. One of `force` and `stress` is written, in differentiable torch.
    """

    name: str
    parameters: tuple[ParameterSpec, ...]
    kind: str = "smooth"

    def force(self, state: PointState, parameters: Mapping[str, Tensor]) -> Tensor:
        """External force on every quadrature point, (N, 3) [N]."""
        raise NotImplementedError

    def stress(self, state: PointState, parameters: Mapping[str, Tensor]) -> Tensor:
        """Further first Piola-Kirchhoff stress at every quadrature point, (N, 3, 3) [Pa]."""
        raise NotImplementedError


def writes(effect: object, function: str) -> bool:
    """Whether an effect has a `force` or `stress` of its own."""
    own = getattr(type(effect), function, None)
    return own is not None and own is not getattr(UserEffect, function)


def register_effect(cls: type) -> type:
    """Make an effect known by its name to every command, diagnosis included. May be used as a decorator.

    Says in one warning line that the effect is slower than a compiled one. Raises ValueError for a class that
    lacks something, or whose name a built-in effect has.
    """
    where = f"effect class {cls.__name__}"
    name = getattr(cls, "name", None)
    if not isinstance(name, str) or not re.fullmatch(r"[a-z][a-z0-9_]*", name):
        raise ValueError(f"{where}: name is {name!r}, expected lower-case letters, digits and underscores")
    parameters = getattr(cls, "parameters", None)
    if (
        not isinstance(parameters, tuple)
        or not parameters
        or not all(isinstance(p, ParameterSpec) for p in parameters)
    ):
        raise ValueError(f"{where}: parameters is {parameters!r}, expected a tuple of ParameterSpec")
    kind = getattr(cls, "kind", "smooth")
    if kind not in KINDS:
        raise ValueError(f"{where}: kind is {kind!r}, expected one of {', '.join(KINDS)}")
    effect = cls()
    functions = [f for f in ("force", "stress") if writes(effect, f)]
    if len(functions) != 1:
        raise ValueError(
            f"{where}: has {' and '.join(functions) or 'no function'}, expected one of force, stress"
        )
    summary = (cls.__doc__ or f"{name}, the user's own").strip().splitlines()[0].rstrip(".")
    add_user_effect(
        EffectSpec(name, summary, kind, "user", parameters, not_with_mls="it has no effects in Python")
    )
    _IMPLEMENTATIONS[name] = effect
    logging.getLogger("mphygs").warning(
        "effect '%s' runs in Python, once a substep: slower than a compiled one", name
    )
    return cls


def implementation(name: str) -> UserEffect:
    """The registered effect of that name. Raises KeyError when there is none."""
    if name not in _IMPLEMENTATIONS:
        raise KeyError(
            f"no effect in Python is called '{name}'; expected one of {', '.join(sorted(_IMPLEMENTATIONS))}"
        )
    return _IMPLEMENTATIONS[name]


def load_plugin(path: str | Path) -> tuple[str, ...]:
    """Run a Python file that registers effects; the names it registered.

    Raises ValueError where the file is missing, fails, or registers nothing.
    """
    path = Path(path)
    if not path.is_file():
        raise ValueError(f"plugin {path}: no such file, expected a Python file that calls register_effect")
    module_name = f"mphygs_plugin_{re.sub(r'[^a-zA-Z0-9]', '_', path.stem)}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None:
        raise ValueError(f"plugin {path}: not a Python file, expected one that ends in .py")
    module = importlib.util.module_from_spec(spec)
    before = dict(_IMPLEMENTATIONS)
    sys.modules[module_name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # whatever the user's file raises is the user's fault, told in one line
        del sys.modules[module_name]
        raise ValueError(f"plugin {path}: {type(error).__name__}: {error}") from error
    names = tuple(n for n, effect in _IMPLEMENTATIONS.items() if before.get(n) is not effect)
    if not names:
        raise ValueError(f"plugin {path}: registered nothing, expected a call of register_effect")
    return names
