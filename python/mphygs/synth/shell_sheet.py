"""The middle of a sheet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class Sheet:
    """place: (a, b, 3) of the middle on a grid [m], the first row on the edge of the hold; thickness: [m]."""

    place: np.ndarray
    thickness: float
