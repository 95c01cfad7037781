"""mphygs: recover what a soft object is made of from how it moves, and say which physics is missing.

The names below are its interface in Python. Each is loaded when it is first used. Some are packages as well:
`mphygs.fit` holds the modules of the fit, and is called like the function `fit`.
"""

from __future__ import annotations

import importlib
import inspect
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mphygs.api.capture_files import load_capture as load_capture
    from mphygs.api.capture_files import save_capture as save_capture
    from mphygs.api.comparing import Comparison as Comparison
    from mphygs.api.comparing import compare as compare
    from mphygs.api.diagnosing import Diagnosis as Diagnosis
    from mphygs.api.diagnosing import diagnose as diagnose
    from mphygs.api.fitting import Fit as Fit
    from mphygs.api.fitting import fit as fit
    from mphygs.api.gradient import rollout as rollout
    from mphygs.api.interface_errors import FailedError as FailedError
    from mphygs.api.interface_errors import InputError as InputError
    from mphygs.api.interface_errors import MissingPackageError as MissingPackageError
    from mphygs.api.interface_errors import MphygsError as MphygsError
    from mphygs.api.model import Model as Model
    from mphygs.api.motion import Motion as Motion
    from mphygs.api.motion import simulate as simulate
    from mphygs.api.stepping import Steps as Steps
    from mphygs.api.stepping import discover as discover
    from mphygs.api.stepping import extend as extend
    from mphygs.capture.actuators import Force as Force
    from mphygs.capture.actuators import Pressure as Pressure
    from mphygs.capture.actuators import Tendon as Tendon
    from mphygs.capture.format import Capture as Capture
    from mphygs.capture.format import Hold as Hold
    from mphygs.capture.format import Known as Known
    from mphygs.capture.format import Load as Load
    from mphygs.capture.format import Markers as Markers
    from mphygs.capture.format import Part as Part
    from mphygs.capture.format import Sensor as Sensor
    from mphygs.capture.format import Sequence as Sequence
    from mphygs.model.descriptor import ParameterSpec as ParameterSpec
    from mphygs.model.user_effect import register_effect as register_effect

_FORMAT, _ACTUATORS = "mphygs.capture.format", "mphygs.capture.actuators"
_WHERE = {
    "Capture": _FORMAT,
    "Comparison": "mphygs.api.comparing",
    "Diagnosis": "mphygs.api.diagnosing",
    "FailedError": "mphygs.api.interface_errors",
    "Fit": "mphygs.api.fitting",
    "Force": _ACTUATORS,
    "Hold": _FORMAT,
    "InputError": "mphygs.api.interface_errors",
    "Known": _FORMAT,
    "Load": _FORMAT,
    "Markers": _FORMAT,
    "MissingPackageError": "mphygs.api.interface_errors",
    "Model": "mphygs.api.model",
    "Motion": "mphygs.api.motion",
    "MphygsError": "mphygs.api.interface_errors",
    "ParameterSpec": "mphygs.model.descriptor",
    "Part": _FORMAT,
    "Pressure": _ACTUATORS,
    "Sensor": _FORMAT,
    "Sequence": _FORMAT,
    "Steps": "mphygs.api.stepping",
    "Tendon": _ACTUATORS,
    "load_capture": "mphygs.api.capture_files",
    "register_effect": "mphygs.model.user_effect",
    "rollout": "mphygs.api.gradient",
    "save_capture": "mphygs.api.capture_files",
}
# Functions that have the name of a package or of a command's module.
_CALLED = {
    "compare": "mphygs.api.comparing",
    "diagnose": "mphygs.api.diagnosing",
    "discover": "mphygs.api.stepping",
    "extend": "mphygs.api.stepping",
    "fit": "mphygs.api.fitting",
    "simulate": "mphygs.api.motion",
}
__all__ = sorted([*_WHERE, *_CALLED])  # pyright: ignore[reportUnsupportedDunderAll]


class _Called(ModuleType):
    """A module that is called like the function of its name."""

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        return _function(self.__name__)(*args, **kwargs)

    @property
    def __signature__(self) -> inspect.Signature:
        return inspect.signature(_function(self.__name__))


def _function(module: str) -> Any:
    name = module.rpartition(".")[2]
    return getattr(importlib.import_module(_CALLED[name]), name)


class _Interface(ModuleType):
    """This module: the import of a package sets it here, and it can be called from then on."""

    def __setattr__(self, name: str, value: object) -> None:
        if name in _CALLED and type(value) is ModuleType:
            value.__class__ = _Called
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Interface


def __getattr__(name: str) -> Any:
    if name in _CALLED:
        return importlib.import_module(f"{__name__}.{name}")
    if name in _WHERE:
        value = getattr(importlib.import_module(_WHERE[name]), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
