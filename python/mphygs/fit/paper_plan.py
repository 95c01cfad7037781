"""The paper's temporal mini-batches: which frames its stages fit, and what they cannot fit.

Windows of 5, 10 and 15 frames, three of each, then two of 25, then all frames; 150 iterations a stage.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mphygs.model.registry import effect

# Frames of a window and how many windows stand one after the other.
WINDOWS = ((5, 3), (10, 3), (15, 3), (25, 2))
ITERATIONS = 150
# A line of progress after so many iterations.
REPORT_EVERY = 10


@dataclass(frozen=True)
class PaperStage:
    """One stage. length: frames of a window, None for all frames at once; count: windows; frames: how many
    of all sequences it simulates."""

    name: str
    spacing: float
    length: int | None
    count: int
    frames: int

    @property
    def reports(self) -> int:
        """Lines of progress to expect."""
        return ITERATIONS // REPORT_EVERY

    @property
    def work(self) -> float:
        """Cost relative to that of other stages."""
        return float(self.frames)


def remembers(names: Iterable[str]) -> bool:
    """Whether what any of these effects does depends on what was before: markers do not tell that of a state
    in mid-motion."""
    return any(effect(name).history for name in names)


def paper_plan(
    spacing: float, ranges: Mapping[str, tuple[int, int]], *, from_rest: bool = False
) -> tuple[PaperStage, ...]:
    """The stages at one spacing [m] for frames to fit per sequence; windows longer than all are left out.

    from_rest: as of `window_frames`.
    """

    def simulated(length: int, count: int, first: int, last: int) -> int:
        if not from_rest:
            return min(count * length, last - first)
        ends = (min(first + (k + 1) * length, last) for k in range(count) if first + k * length < last)
        return sum(ends)

    longest = max(last - first for first, last in ranges.values())
    found = [
        PaperStage(
            f"{count} windows of {length} frames", spacing, length, count,
            sum(simulated(length, count, *span) for span in ranges.values()),
        )
        for length, count in WINDOWS
        if length < longest
    ]  # fmt: skip
    return (*found, PaperStage("all frames", spacing, None, 1, sum(last for _, last in ranges.values())))


def window_frames(
    stage: PaperStage, span: tuple[int, int], release: int | None, *, from_rest: bool = False
) -> list[tuple[int | None, int, int]]:
    """(start, first, last) of every window of one sequence.

    span: frames to fit; release: frame at which motion begins, None for frame 0; from_rest: no window begins
    in mid-motion, but with all of the motion before it, for models that remember it. start: frame in
    mid-motion whose state begins the run, None where it begins at rest; first, last: frames [first, last)
    that count.
    """
    first, last = span
    begin = max(first, release or 0)
    if stage.length is None or begin >= last:
        return [(None, first, last)]
    found: list[tuple[int | None, int, int]] = []
    for k in range(stage.count):
        at = begin + k * stage.length
        end = min(at + stage.length, last)
        if end - at < 2:
            break
        if at <= (release or 0):
            found.append((None, first, end))
        elif from_rest:
            found.append((None, at, end))
        else:
            found.append((at, at + 1, end))
    return found


def check_windows(names: Iterable[str]) -> None:
    """Raises ValueError, one line, for an effect that windows in mid-motion cannot fit."""
    for name in names:
        if effect(name).fault:
            raise ValueError(
                f"--schedule paper: the effect '{name}' is a fault of the measurement, from which the "
                "windows take their states; expected --schedule fast for it"
            )
