"""Correction for many tests."""

from __future__ import annotations

from collections.abc import Mapping


def holm(p_values: Mapping[str, float]) -> dict[str, float]:
    """Adjusted p-values by name: those up to a level are significant together at that level (Holm, 1979).

    Raises ValueError on a p-value outside [0, 1].
    """
    for name, value in p_values.items():
        if not 0.0 <= value <= 1.0:
            raise ValueError(f"{name}: p-value {value}, expected a number in [0, 1]")
    adjusted: dict[str, float] = {}
    running = 0.0
    for rank, name in enumerate(sorted(p_values, key=lambda n: p_values[n])):
        running = max(running, min(1.0, (len(p_values) - rank) * p_values[name]))
        adjusted[name] = running
    return {name: adjusted[name] for name in p_values}
