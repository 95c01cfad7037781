"""The frame of every command: typed options, progress, one answer, exit codes.

Exit code 0: done; 2: the input or the options are at fault; 1: anything else; 130: interrupted by the user.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import shlex
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from mphygs.capture.errors import one_line
from mphygs.capture.json_values import plain
from mphygs.commands.console import Console
from mphygs.commands.in_use import held, hold
from mphygs.commands.options import (
    CommonOptions,
    OptionError,
    OptionsType,
    check_counts,
    read_options,
)
from mphygs.model.user_effect import load_plugin

DONE, FAILED, AT_FAULT, INTERRUPTED = 0, 1, 2, 130
# Set to anything, this shows where an error comes from.
TRACEBACK_VARIABLE = "MPHYGS_TRACEBACK"
# What the system says of a place that cannot be written to, whatever is tried again.
_NO_PLACE = {
    errno.EEXIST, errno.EISDIR, errno.ENOTDIR, errno.EACCES, errno.EPERM, errno.EROFS, errno.ENAMETOOLONG,
    errno.ELOOP, errno.ENOENT,
}  # fmt: skip


@dataclass(frozen=True)
class Answer:
    """What a command found. document: for --json; text: for people; code: to exit with."""

    document: dict[str, object]
    text: str
    code: int = DONE


def run(
    options_type: type[OptionsType],
    action: Callable[[OptionsType, Console], Answer],
    *,
    program: str,
    argv: Sequence[str] | None = None,
) -> int:
    """Run one command and return its exit code. argv: None takes the process's own arguments."""
    try:
        options = read_options(options_type, program, sys.argv[1:] if argv is None else argv)
    except OptionError as error:
        sys.stderr.write(f"{program}: {error}\n")
        return AT_FAULT
    if options is None:
        return DONE
    console = Console(sys.stderr, live=not options.json)
    answer, code = _guarded(action, options, console, program)
    if answer is None:
        return code
    if options.json:
        sys.stdout.write(json.dumps(plain(answer.document), allow_nan=False) + "\n")
    else:
        sys.stdout.write(answer.text.rstrip("\n") + "\n")
    sys.stdout.flush()
    return code


def _resumed_in(options: CommonOptions) -> Path | None:
    """The folder in which a command goes on that keeps there what it has found so far."""
    if not hasattr(options, "resume"):
        return None
    if hasattr(options, "out"):
        return options.out if options.resume else None
    return getattr(options, "run", None)


def _with_plugin(line: str, options: CommonOptions) -> str:
    """A command line that goes on with a command, with the plugin that it was given."""
    given = options.plugin is not None and "--plugin" not in line
    return f"{line} --plugin {shlex.quote(str(options.plugin))}" if given else line


# Threads of one process take turns: folders are held, and libraries are limited, for all of them.
_TURN = threading.RLock()


@contextlib.contextmanager
def working(options: CommonOptions) -> Iterator[None]:
    """What every action runs in: its options checked, its plugin run, its folders held until it ends.

    Simulations have the cores: threads of the linear algebra that wait for work slow them down, and its last
    digits would depend on how many there are.
    """
    check_counts(options)
    with _TURN, held(), threadpool_limits(1, user_api="blas"):
        if options.plugin is not None:
            load_plugin(options.plugin)
        going_on = _resumed_in(options)
        if going_on is not None and going_on.is_dir():
            hold(going_on)
        yield


def error_line(error: Exception) -> tuple[str, int]:
    """The one line that an error ends in, and its exit code."""
    # numpy's LinAlgError is a ValueError that no input explains.
    at_fault = isinstance(error, (ValueError, FileNotFoundError)) and not isinstance(
        error, np.linalg.LinAlgError
    )
    message = one_line(str(error)) or type(error).__name__
    if isinstance(error, OSError) and error.filename is not None:
        at_fault = error.errno in _NO_PLACE
        where = one_line(str(error.filename2 or error.filename))
        message = f"{where}: {error.strerror}; expected a place to read and write"
    if isinstance(error, (KeyError, AttributeError, TypeError, IndexError)):
        message = f"unexpected {type(error).__name__}: {message} (set {TRACEBACK_VARIABLE}=1 to see where)"
    return message, AT_FAULT if at_fault else FAILED


def _guarded(
    action: Callable[[OptionsType, Console], Answer], options: OptionsType, console: Console, program: str
) -> tuple[Answer | None, int]:
    try:
        # Whatever a library prints must not reach the answer's stream.
        with contextlib.redirect_stdout(sys.stderr), working(options):
            answer = action(options, console)
            return answer, answer.code
    except KeyboardInterrupt:
        console.end()
        hint = f"; continue with: {_with_plugin(console.resume, options)}" if console.resume else ""
        console.say(f"{program}: interrupted{hint}")
        return None, INTERRUPTED
    except Exception as error:  # every error ends in one line and its exit code
        console.end()
        if os.environ.get(TRACEBACK_VARIABLE):
            console.say(traceback.format_exc())
        message, code = error_line(error)
        console.say(f"{program}: {message}")
        return None, code
    finally:
        console.end()
