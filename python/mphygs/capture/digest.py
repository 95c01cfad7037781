"""By what files are known: the same digest, the same content."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

# In a folder these are read whole, and so is all that is no longer than both its ends [byte].
_WHOLE = (".bin", ".json", ".txt")
_END = 1 << 16


def digest_of(path: Path, scale: float = 1.0) -> str:
    """SHA-256 of a file, or of the names and contents of all files in a folder. scale: metres per unit.

    Of pictures and videos in a folder, sizes, beginnings and ends are enough: reading all of them takes
    longer than some stages, and their ends depend on all before.
    """
    found = hashlib.sha256()
    if path.is_dir():
        for file in sorted(p for p in path.rglob("*") if p.is_file()):
            found.update(f"{file.relative_to(path).as_posix()} {file.stat().st_size} ".encode())
            found.update(_ends(file))
    else:
        found.update(path.read_bytes())
    return found.hexdigest() if scale == 1.0 else f"{found.hexdigest()} x {scale!r}"


def _ends(file: Path) -> bytes:
    with file.open("rb") as stream:
        if file.suffix in _WHOLE or file.stat().st_size <= 2 * _END:
            return stream.read()
        first = stream.read(_END)
        stream.seek(-_END, os.SEEK_END)
        return first + stream.read()
