"""How thick a solid is at every place: the largest ball in it that covers the place."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt


def local_thickness(distance: np.ndarray, *, spacing: float, levels: int = 12) -> np.ndarray:
    """(X, Y, Z) [m], the diameter of the largest ball inside the solid that covers a voxel; 0 outside.

    distance: (X, Y, Z) from the surface [m], negative inside. Hildebrand and Ruegsegger 1997, for `levels`
    radii in geometric steps from a voxel's half to the largest ball; at most one step too small.
    """
    depth = np.maximum(-distance, 0.0)
    thickness = np.where(depth > 0, 2.0 * depth, 0.0)
    largest = float(depth.max(initial=0.0))
    if largest <= 0:
        return thickness
    for radius in np.geomspace(min(0.5 * spacing, largest), largest, levels):
        centres = depth >= radius * (1 - 1e-9)
        away = distance_transform_edt(~centres, sampling=spacing)
        covered = (away < radius) & (depth > 0)
        thickness[covered] = np.maximum(thickness[covered], 2.0 * radius)
    return thickness
