"""Options of the commands: what all of them take, how a command line is read, and what is wrong with it."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import tyro

from mphygs.capture.errors import one_line


class OptionError(ValueError):
    """Options that cannot be used: one line with what, where, and what was expected."""


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options of every command."""

    json: bool = False
    """Print exactly one JSON object on standard output; everything else goes to standard error."""
    plugin: Path | None = None
    """Python file that registers effects of your own, to be named like the others. It is run where it is
    named here and nowhere else, whatever a run says of the file that it was made with."""


OptionsType = TypeVar("OptionsType", bound=CommonOptions)


def split_names(text: str | None) -> tuple[str, ...]:
    """The names of a comma-separated list; none for None and for an empty text."""
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


def check_counts(options: CommonOptions) -> None:
    """Raises OptionError for numbers that many commands take and that are out of their range."""
    for name, least, most in (("workers", 1, 4096), ("seed", 0, (1 << 64) - 1)):
        value = getattr(options, name, None)
        if value is not None and not least <= value <= most:
            more = f", at most {most}" if value > most else ""
            raise OptionError(f"--{name}: got {value}; expected {least} or more{more}")


# Options that may stand without their value, and what they mean then.
_VALUES = {"--feedback": "1"}


def _with_values(argv: Sequence[str]) -> list[str]:
    """The arguments, an option that may stand alone followed by its value."""
    words = list(argv)
    for k in reversed(range(len(words))):
        alone = k + 1 == len(words) or not re.fullmatch(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?", words[k + 1])
        if words[k] in _VALUES and alone:
            words.insert(k + 1, _VALUES[words[k]])
    return words


def check_gain(gain: float | None) -> None:
    """Raises OptionError for a gain of the feedback that is none."""
    if gain is not None and not 0.0 < gain <= 1.0:
        raise OptionError(f"--feedback: got {gain:g}; expected a gain above 0, at most 1")


def read_options(
    options_type: type[OptionsType], program: str, words: Sequence[str]
) -> OptionsType | None:
    """The options that the words of a command line give; None after --help, which is printed.

    Raises OptionError for words that cannot be read.
    """
    heard = io.StringIO()
    try:
        with contextlib.redirect_stderr(heard):
            return tyro.cli(
                options_type,
                prog=program,
                args=_with_values(words),
                config=(tyro.conf.FlagCreatePairsOff,),
            )
    except SystemExit as stop:
        if stop.code in (0, None):
            return None
        complaint = heard.getvalue().split("For full helptext")[0]
        # The parser draws its complaint in a box, or ruled off, below a title that says less.
        plain = re.sub(r"[─-╿]+|-{3,}", " ", re.sub(r"\x1b\[[0-9;]*m", "", complaint))
        title, *lines = [line for line in plain.splitlines() if line.strip()]
        words = " ".join(lines) or title
        raise OptionError(f"{one_line(words)} (see {program} --help)") from None
