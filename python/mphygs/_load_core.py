"""Which compiled core a portable wheel loads: the fastest that this processor runs.

Such a wheel holds `_core_v2`, `_core_v3` and `_core_v4`, compiled for the levels of x86-64, and
`_processor`, compiled for any of them, which asks the processor. A build for one processor, the
default, installs the single module `_core` instead, and Python prefers it to `_core.py`.
"""

import importlib
from types import ModuleType

_LOWEST = 2
_HIGHEST = 4


def variant_name(level: int) -> str:
    """Name of the module for a processor of an x86-64 level.

    level: 1 to 4, as `_processor.level()` gives it; higher ones run the highest variant.
    Raises ImportError for a processor below x86-64-v2.
    """
    if level < _LOWEST:
        raise ImportError(
            f"mphygs: this processor is x86-64-v{level}, the wheel needs x86-64-v{_LOWEST} (SSE4.2); "
            "build from source for it: pip install --no-binary mphygs mphygs"
        )
    return f"mphygs._core_v{min(level, _HIGHEST)}"


def load() -> ModuleType:
    """The compiled core of a portable wheel. Raises ImportError where the package was never compiled."""
    try:
        processor = importlib.import_module("mphygs._processor")
    except ModuleNotFoundError as error:
        raise ImportError(
            "mphygs: the compiled core is missing; install the package (pip install .)"
        ) from error
    return importlib.import_module(variant_name(processor.level()))
