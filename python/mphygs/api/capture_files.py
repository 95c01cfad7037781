"""Captures from and to their folders."""

from __future__ import annotations

from pathlib import Path

from mphygs.api.interface_errors import as_interface_errors
from mphygs.capture import format as capture_format
from mphygs.capture.format import Capture


def load_capture(path: str | Path) -> Capture:
    """The capture in a folder. Raises InputError: which file and key is at fault, and what was expected."""
    with as_interface_errors():
        return capture_format.load_capture(path)


def save_capture(capture: Capture, folder: str | Path) -> None:
    """Write a capture to a folder that reads back equal. Raises InputError where it contradicts itself."""
    with as_interface_errors():
        capture_format.save_capture(capture, folder)
