"""Where a command reports while it runs: lines, and on a terminal one live line below them."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, field
from typing import TextIO

from mphygs.fit.countdown import duration

# Of a live line, characters that say what is done.
SHOWN = 60


@dataclass
class Console:
    """resume: the command line that continues the work when it is stopped; live: whether there is a live line
    where the stream is a terminal. Elsewhere every line of progress stands by itself."""

    stream: TextIO
    resume: str | None = None
    live: bool = False
    _begin: float = field(default_factory=time.monotonic)
    _line: _LiveLine | None = None

    @property
    def seconds(self) -> float:
        """Time since the work began [s]."""
        return time.monotonic() - self._begin

    def begin(self) -> None:
        """Count time from here: what went before says nothing of how long the rest takes."""
        self._begin = time.monotonic()

    def say(self, text: str) -> None:
        """One line of report."""
        if self._line is not None:
            self._line.above(text)
            return
        self.stream.write(f"{text}\n")
        self.stream.flush()

    def progress(self, share: float, text: str) -> None:
        """What is being done; share: of the whole work that is done, 0 to 1."""
        share = min(max(share, 0.0), 1.0)
        left = self.seconds * (1.0 - share) / share if share > 0.0 else None
        if self._show(text, share, left):
            return
        about = "" if left is None else f", about {duration(left)} left"
        self.say(f"[{100.0 * share:3.0f} %, {duration(self.seconds)}{about}] {text}")

    def working(self, text: str) -> None:
        """What is being done where nobody knows how much of it there is."""
        self._show(text, None, None)

    def end(self) -> None:
        """Take the live line away."""
        if self._line is not None:
            self._line.stop()
            self._line = None

    def _show(self, text: str, share: float | None, left: float | None) -> bool:
        if self._line is None and self.live and is_terminal(self.stream):
            self._line = _LiveLine(self.stream)
        if self._line is not None:
            self._line.show(text, share, left)
        return self._line is not None


def is_terminal(stream: TextIO) -> bool:
    """Whether what is written to a stream can be redrawn."""
    return stream.isatty() and os.environ.get("TERM", "dumb") != "dumb"


class _LiveLine:
    """Stage, share, time spent and left, redrawn in place."""

    def __init__(self, stream: TextIO) -> None:
        from rich.console import Console as Terminal
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        self._terminal = Terminal(file=stream)
        self._progress = Progress(
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=20),
            TextColumn("{task.fields[share]}", markup=False),
            TimeElapsedColumn(),
            TextColumn("{task.fields[left]}", markup=False),
            console=self._terminal,
            transient=True,
        )
        self._task = self._progress.add_task("", total=None, share="", left="")
        self._progress.start()

    def above(self, text: str) -> None:
        """Lines above it."""
        self._terminal.print(text, markup=False, highlight=False, soft_wrap=True)

    def show(self, text: str, share: float | None, left: float | None) -> None:
        text = text if len(text) <= SHOWN else f"{text[: SHOWN - 1]}…"
        self._progress.update(
            self._task,
            description=text,
            total=None if share is None else 1.0,
            completed=share or 0.0,
            share="" if share is None else f"{100.0 * share:.0f} %",
            left="" if left is None else f"about {duration(left)} left",
        )

    def stop(self) -> None:
        self._progress.stop()
