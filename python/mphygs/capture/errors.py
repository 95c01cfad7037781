"""The one error of reading a capture: what is wrong, where, and what was expected, on one line."""

from __future__ import annotations


class CaptureError(ValueError):
    """A capture folder that cannot be used as it stands. The message is always one line."""

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


def fault(where: str, what: str, expected: str) -> CaptureError:
    """An error that says where (file and key), what is wrong there, and what was expected."""
    return CaptureError(f"{where}: {what}; expected {expected}")
