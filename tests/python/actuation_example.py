"""A tendon to a point in space and a force that changes with time, on carriers of any discretisation."""

from __future__ import annotations

import numpy as np

CHANNELS = 4


def actuation(carriers: int) -> dict[str, object]:
    """As the core takes it, for so many carriers."""
    whole = {
        "row_begin": [0, 2, 4, 4],
        "row_carrier": [0, carriers // 3, carriers // 2, carriers - 1],
        "hold": [-1, -1, -1],
        "force_point": [0],
        "force_channel": [1],
        "path_begin": [0, 3],
        "path_point": [0, 1, 2],
        "path_channel": [0],
        "triangle": [],
        "triangle_middle": [],
        "triangle_channel": [],
    }
    place = np.array([[0.005, 0.01, 0.01], [0.025, 0.012, 0.01], [0.06, 0.02, 0.03]])
    numbers: dict[str, object] = {name: np.array(values, np.int32) for name, values in whole.items()}
    return numbers | {"row_weight": np.full(4, 0.5), "place": place, "channel_count": CHANNELS}


def channels(intervals: int, generator: np.random.Generator) -> np.ndarray:
    """(F, C, 4) of a tension and a force about 0.05 N, none at a special value."""
    course = 0.01 * generator.standard_normal((intervals, CHANNELS, 4))
    course[..., 0] += 0.05
    return course
