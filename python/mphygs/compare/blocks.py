"""Observations grouped by part and by stretch of time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Block:
    """Observations of one part in frames first .. last, both included."""

    part: str
    first: int
    last: int


@dataclass(frozen=True)
class Blocks:
    """blocks: B of them. index: (N,) which block each observation is in."""

    blocks: tuple[Block, ...]
    index: NDArray[np.int_]

    def __len__(self) -> int:
        return len(self.blocks)

    def rows(self) -> list[NDArray[np.int_]]:
        """Observations of each block."""
        order = np.argsort(self.index, kind="stable")
        ends = np.cumsum(np.bincount(self.index, minlength=len(self)))
        return np.split(order, ends[:-1])


def part_time_blocks(
    part: NDArray[np.int_], frame: NDArray[np.int_], *, names: Sequence[str], length: int
) -> Blocks:
    """Blocks of every part and about `length` frames, equal stretches, empty ones left out.

    part, frame: (N,) of each observation; part indexes `names`.
    Raises ValueError on a length below 1 or on arrays that do not fit.
    """
    if length < 1 or part.shape != frame.shape or part.ndim != 1:
        raise ValueError(f"blocks: length {length} of at least 1 and part and frame of equal length expected")
    first, frames = int(frame.min()), int(frame.max() - frame.min()) + 1
    stretches = max(1, round(frames / length))
    edges = first + np.round(np.linspace(0, frames, stretches + 1)).astype(int)
    stretch = np.searchsorted(edges, frame, side="right") - 1
    present, index = np.unique(part * stretches + stretch, return_inverse=True)
    found = tuple(
        Block(names[k // stretches], int(edges[k % stretches]), int(edges[k % stretches + 1]) - 1)
        for k in present
    )
    return Blocks(found, index)
