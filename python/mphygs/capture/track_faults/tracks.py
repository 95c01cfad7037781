"""Tracks as a file has them, and what is noticed in them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np


@dataclass(frozen=True)
class Finding:
    """One fault of a measurement. fault: its public name; text: what, where and what was made of it; numbers:
    how many or how much, in SI units."""

    fault: str
    text: str
    numbers: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class ExaminedTracks:
    """position: (T, M, 3) [m], NaN where not measured; at: (M, 3) [m] places on the object at rest; sigma: of
    a coordinate [m], as stated; release: all points rest until this frame, None where none is stated;
    zero_is_missing: as the capture says, None where it does not; raw: the file's own numbers [m], where they
    were turned since; scatter: (M,) [m], each marker's own standard
    deviation where they differ; findings: so far; begins: as the sequence states
    its start, None where it does not; lasting: [m] of a coordinate of each marker's own constant error."""

    position: np.ndarray
    at: np.ndarray
    sigma: float
    release: int | None = None
    zero_is_missing: bool | None = None
    raw: np.ndarray | None = None
    scatter: np.ndarray | None = None
    findings: tuple[Finding, ...] = ()
    begins: str | None = None
    lasting: float = 0.0

    @property
    def seen(self) -> np.ndarray:
        """(T, M) bool."""
        return np.isfinite(self.position).all(axis=2)

    def found(self, finding: Finding, **changes: object) -> ExaminedTracks:
        """The tracks after a finding."""
        return replace(self, findings=(*self.findings, finding), **changes)


def listed(items: list[str], most: int = 3) -> str:
    """The first few of some words."""
    more = f" and {len(items) - most} more" if len(items) > most else ""
    return ", ".join(items[:most]) + more
