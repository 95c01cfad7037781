"""Folders that a command writes to: it holds them while it works, and marks them."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import socket
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from mphygs.capture.folder_mark import FORMAT, MARK


class HeldError(ValueError):
    """A folder that another command writes to: one line says which."""


@dataclass
class _Held:
    """A folder held by this process. made: folders that were made for it, innermost first."""

    descriptor: int
    made: list[Path] = field(default_factory=list)


_HELD: dict[Path, _Held] = {}


def hold(folder: Path) -> None:
    """Make a folder, mark it, and keep other commands from writing there until `held` ends.

    Raises HeldError where another one does so now, OSError where the folder cannot be written to.
    """
    path = folder.resolve()
    if path in _HELD:
        return
    made = []
    while not path.is_dir():
        made.append(path)
        path = path.parent
    folder.mkdir(parents=True, exist_ok=True)
    mark = folder / MARK
    # not through a link: what it leads to is not this program's
    descriptor = os.open(mark, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o666)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # let go and taken away by its holder meanwhile
        gone = os.fstat(descriptor).st_nlink == 0
    except OSError as error:
        # A file system without locks: nothing keeps two commands apart there.
        gone = False
        if error.errno in (errno.EAGAIN, errno.EACCES):
            holder = _holder(descriptor)
            os.close(descriptor)
            raise HeldError(
                f"{folder}: {holder} writes there now; expected another folder, or to wait until it is done"
            ) from error
    if gone:
        os.close(descriptor)
        hold(folder)
        return
    _HELD[folder.resolve()] = _Held(descriptor, made)
    command = " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])
    _tell(descriptor, {"pid": os.getpid(), "host": socket.gethostname(), "command": command[:500]})


@contextlib.contextmanager
def held() -> Iterator[None]:
    """Lets go, at its end, of the folders that were held within; those in which nothing was written go."""
    before = set(_HELD)
    try:
        yield
    finally:
        for path in reversed([path for path in _HELD if path not in before]):
            _release(path, _HELD.pop(path))


def _release(path: Path, kept: _Held) -> None:
    with contextlib.suppress(OSError):
        _tell(kept.descriptor, {})
        if kept.made and {item.name for item in path.iterdir()} == {MARK}:
            (path / MARK).unlink()
            for folder in kept.made:
                folder.rmdir()
    os.close(kept.descriptor)


def _tell(descriptor: int, holder: dict[str, object]) -> None:
    content = json.dumps({"format": FORMAT, **holder}).encode() + b"\n"
    os.ftruncate(descriptor, 0)
    os.pwrite(descriptor, content, 0)


def _holder(descriptor: int) -> str:
    """The command that holds a mark, in words."""
    try:
        told = json.loads(os.pread(descriptor, 10_000, 0))
        return f"process {int(told['pid'])} on {told['host']} ({told['command']})"
    except (OSError, ValueError, KeyError, TypeError):
        return "another command"
