"""Arrays of a .safetensors file that anybody may have written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file

from mphygs.capture.archives import MOST_NUMBERS
from mphygs.capture.errors import fault

_LARGEST = 8 * MOST_NUMBERS  # bytes


def read_tensors(path: Path, expected: str) -> dict[str, np.ndarray]:
    """All arrays of a file, by name. Raises CaptureError where it cannot be read or is larger than any that
    is written."""
    try:
        size = path.stat().st_size
        if size > _LARGEST:
            raise fault(str(path), f"has {size} bytes", f"{expected}, at most {_LARGEST} bytes")
        return load_file(path)
    except (OSError, SafetensorError, KeyError, TypeError, AttributeError) as error:
        # dtypes that numpy has not end in the last three
        raise fault(str(path), f"cannot be read ({error})", expected) from error
