"""The mark of folders that this program writes to, and whether another process writes there now."""

from __future__ import annotations

import errno
import fcntl
import json
import os
from pathlib import Path

# In every folder that this program was given to write to; while a command writes there, it says which one.
MARK = ".mphygs"
FORMAT = "mphygs-folder/1"


def is_marked(folder: Path) -> bool:
    """Whether a folder carries the mark."""
    try:
        return json.loads((folder / MARK).read_text(encoding="utf-8")).get("format") == FORMAT
    except (OSError, ValueError, AttributeError, RecursionError):
        return False


def is_held(folder: Path) -> bool:
    """Whether another process writes to a folder now."""
    try:
        descriptor = os.open(folder / MARK, os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno in (errno.EAGAIN, errno.EACCES)
    finally:
        os.close(descriptor)
    return False
