"""Files that are written wholly or not at all."""

from __future__ import annotations

import io
import os
import secrets
from collections.abc import Mapping
from pathlib import Path

import numpy as np


def replace_file(path: Path, content: bytes | str) -> None:
    """Put a file of this content (text as UTF-8) in the place of what stands there, a link included.

    Broken off at any moment, the old file or the new one stands there; writers side by side do not meet.
    Raises OSError, which names the path, where it cannot be written: nothing is left of it then.
    """
    part = path.with_name(f".part-{os.getpid()}-{secrets.token_hex(4)}")
    try:
        with part.open("xb") as stream:
            stream.write(content.encode() if isinstance(content, str) else content)
            stream.flush()
            os.fsync(stream.fileno())
        os.replace(part, path)
    except OSError as error:
        # a full disk does not say which file it was
        raise OSError(error.errno, error.strerror, str(path)) from error
    finally:
        part.unlink(missing_ok=True)


def replace_arrays(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    """The same for an .npz."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    replace_file(path, buffer.getvalue())
