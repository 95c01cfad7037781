"""Files that are written wholly or not at all."""

from __future__ import annotations

import io
import os
import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np


def replace_file(path: Path, content: bytes | str) -> None:
    """Put a file of this content (text as UTF-8) in the place of what stands there, a link included.

    Broken off at any moment, the old file or the new one stands there; writers side by side do not meet.
    Raises OSError, which names the path, where it cannot be written: nothing is left of it then.
    """
    part = path.with_name(f".part-{os.getpid()}-{secrets.token_hex(4)}")
    with naming(path):
        try:
            with part.open("xb") as stream:
                stream.write(content.encode() if isinstance(content, str) else content)
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(part, path)
        finally:
            part.unlink(missing_ok=True)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Names the file in what the system says of it: a full disk does not say which one it was."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from error


def replace_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """The same for an .npz."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    replace_file(path, buffer.getvalue())
