"""How much of the work is done, and about how long the rest of it takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping


def duration(seconds: float) -> str:
    """A time span in words of one glance."""
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    if seconds < 6000.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


class Countdown:
    """Tells of a stage whose work can be told beforehand. work: all of it, in any unit."""

    def __init__(self, report: Callable[[str], None] | None, stage: str, work: float) -> None:
        self._report, self._stage = report, stage
        self._done, self._left = 0.0, work
        self._begin = time.monotonic()

    def done(self, work: float, *, left: float | None = None) -> None:
        """So much more is done. left: what is left now, where that is not just so much less."""
        self._done += work
        self._left = max(self._left - work, 0.0) if left is None else left
        if self._report is None or self._left <= 0.0 or self._done <= 0.0:
            return
        seconds = (time.monotonic() - self._begin) * self._left / self._done
        share = self._done / (self._done + self._left)
        self._report(f"{self._stage}: {share:.0%} done, about {duration(seconds)} left of it")


class Pieces:
    """Pieces of work, one after the other, told as one whole. works: of each by name, in any unit."""

    def __init__(self, progress: Callable[[float, str], None], works: Mapping[str, float]) -> None:
        self._progress = progress
        self._spans: dict[str, tuple[float, float]] = {}
        total, begun = sum(works.values()), 0.0
        for name, work in works.items():
            self._spans[name] = begun / total, work / total
            begun += work

    def shares(self, name: str) -> Callable[[float, str], None]:
        """Told the share of one piece that is done, and a line."""
        first, width = self._spans[name]
        return lambda share, line: self._progress(first + width * min(share, 1.0), line)

    def lines(self, name: str, expected: int) -> Callable[[str], None]:
        """Told a line at the beginning of each of so many steps of one piece."""
        tell, told = self.shares(name), iter(range(expected))
        return lambda line: tell(next(told, expected) / expected, line)
