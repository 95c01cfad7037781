"""How far all runs of a batch are, in one view."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence

from mphygs.batch.dispatch import Running
from mphygs.batch.work import last_line
from mphygs.commands.console import Console, is_terminal

# Seconds between two views: where they take each other's place, and where each is written below the last.
REDRAWN, TOLD = 0.5, 30.0


class BatchView:
    """Draws the runs under way with what each said last; on a terminal in the place of the last view.

    before: runs that were done when the batch began; total: of all runs.
    """

    def __init__(self, console: Console, *, before: int, total: int) -> None:
        self._console, self._before, self._total = console, before, total
        self._done, self._failed = before, 0
        self._terminal = is_terminal(console.stream)
        self._lines, self._next = 0, 0.0

    def ended(self, text: str, *, failed: bool) -> None:
        """One more run has ended. text: said of it."""
        self._done += 1
        self._failed += failed
        self._wipe()
        share = (self._done - self._before) / (self._total - self._before)
        self._console.progress(share, f"{self._counts()}; {text}")
        self._next = 0.0 if self._terminal else time.monotonic() + TOLD

    def look(self, running: Sequence[Running], workers: int) -> None:
        """Draw what is under way, unless that was done a moment ago."""
        if time.monotonic() < self._next or not (running or not workers):
            return
        self._next = time.monotonic() + (REDRAWN if self._terminal else TOLD)
        self._wipe()
        width = shutil.get_terminal_size().columns if self._terminal else 1000
        head = f"{self._counts()}, {len(running)} under way on {workers} workers"
        lines = [head if workers else f"{head}: waiting for one"]
        longest = max((len(one.task.name) for one in running), default=0)
        lines += [f"  {one.task.name.ljust(longest)}  {last_line(one.task.log)}" for one in running]
        for line in lines:
            self._console.say(line[: width - 1])
        self._lines = len(lines)

    def _counts(self) -> str:
        failed = f", {self._failed} failed" if self._failed else ""
        return f"{self._done} of {self._total} done{failed}"

    def _wipe(self) -> None:
        """Take the last view away, where it can be."""
        if self._terminal and self._lines:
            self._console.stream.write(f"\x1b[{self._lines}F\x1b[J")
        self._lines = 0
