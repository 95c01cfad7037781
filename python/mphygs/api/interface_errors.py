"""What goes wrong, in the one line that a command would have ended in."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator


class MphygsError(Exception):
    """Any error of this interface. Its text is one line: what is wrong, where, and what was expected; its
    cause is the error that it came from."""


class InputError(MphygsError, ValueError):
    """The data or the arguments are at fault (a command's exit code 2)."""


class FailedError(MphygsError, RuntimeError):
    """Anything else: a simulation that is unstable, a full disk (a command's exit code 1)."""


class MissingPackageError(MphygsError, ImportError):
    """A package that this needs and that is not installed."""


@contextlib.contextmanager
def as_interface_errors() -> Iterator[None]:
    """Errors from within become those of this interface."""
    # the frame of the commands takes a moment to import
    from mphygs.commands.command import AT_FAULT, error_line

    try:
        yield
    except MphygsError:
        raise
    except Exception as error:  # as a command does, every one
        line, code = error_line(error)
        raise (InputError if code == AT_FAULT else FailedError)(line) from error
