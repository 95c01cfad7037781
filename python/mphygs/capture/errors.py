"""The one error of reading a capture: what is wrong, where, and what was expected, on one line."""

from __future__ import annotations

import re

# Characters of a text that are shown where it is longer: of a word, and of a whole message.
_LONGEST_WORD, _LONGEST_LINE = 300, 1500


class CaptureError(ValueError):
    """A capture folder that cannot be used as it stands. The message is always one line."""

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def fault(where: str, what: str, expected: str) -> CaptureError:
    """An error that says where (file and key), what is wrong there, and what was expected."""
    return CaptureError(f"{where}: {what}; expected {expected}")


def one_line(text: str) -> str:
    """A message that any terminal can show: on one line, without control characters, neither of it too long.

    Names and paths in it come from files that anybody wrote. What does not print is written as in a Python
    text; the middle of a very long word, or of the whole, is left out.
    """
    words = re.sub(r"\S+", lambda found: _middle_out(found[0], _LONGEST_WORD), text)
    shown = "".join(c if c.isprintable() else _escaped(c) for c in " ".join(words.split()))
    return _middle_out(shown, _LONGEST_LINE)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")


def _middle_out(text: str, longest: int) -> str:
    """A text whose middle is left out where it is longer."""
    kept = (longest - 3) // 2
    return text if len(text) <= longest else f"{text[:kept]}...{text[-kept:]}"
