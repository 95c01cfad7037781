"""A patch of the object's open surface as triangles whose corners can be carried by the material."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mphygs.scene.rays import checked_boxes
from mphygs.scene.surface import covered_by, cut_by_box, cut_by_plane

if TYPE_CHECKING:
    from mphygs.capture.format import Part

# In units of max_edge: corners nearer to each other are one, and another part so close is in contact.
_SAME, _REACH = 1e-6, 1e-3


@dataclass(frozen=True)
class Patch:
    """vertices: (V, 3) [m]; triangles: (Q, 3) of them, outward; part: (V,) whose surface each is on."""

    vertices: np.ndarray
    triangles: np.ndarray
    part: np.ndarray


def surface_patch(
    parts: Sequence[Part],
    *,
    max_edge: float,
    part: str | None = None,
    box: np.ndarray | None = None,
    exclude_boxes: np.ndarray | None = None,
) -> Patch:
    """The open surface of a part (None: of all), in a box (2, 3) [m] (None: everywhere).

    Triangles are cut by the faces of the boxes and by planes max_edge [m] apart, alike on both sides of every
    edge, so that a closed surface stays one. exclude_boxes: (H, 2, 3) [m], held material, whose surface is
    left out; so is what touches another part.
    """
    excluded = checked_boxes(exclude_boxes, "exclude_boxes")
    reach = _REACH * max_edge
    bounds = [np.stack([p.vertices.min(axis=0), p.vertices.max(axis=0)]) for p in parts]
    vertices, triangles, owner, count = [], [], [], 0
    for number, own in enumerate(parts):
        if part not in (None, own.name):
            continue
        near = [k for k in range(len(parts)) if k != number and _meet(bounds[number], bounds[k], reach)]
        pieces = own.vertices[own.faces]
        boxes = [*excluded, *([] if box is None else [box]), *(bounds[k] for k in near)]
        for limits in boxes:
            pieces = cut_by_box(pieces, limits, reach)
        low, high = pieces.min(axis=(0, 1)), pieces.max(axis=(0, 1))
        for axis in range(3):
            slices = int(np.ceil((high[axis] - low[axis]) / max_edge - 1e-9))
            for plane in np.linspace(low[axis], high[axis], max(slices, 1) + 1)[1:-1]:
                pieces = cut_by_plane(pieces, axis, float(plane), 1e-6 * reach)
        middle = pieces.mean(axis=1)
        normal = np.cross(pieces[:, 1] - pieces[:, 0], pieces[:, 2] - pieces[:, 0])
        size = np.linalg.norm(normal, axis=1)
        kept = size > 1e-12 * max_edge**2
        normal /= np.where(size > 0.0, size, 1.0)[:, None]
        if box is not None:
            kept &= np.all((middle >= box[0] - reach) & (middle <= box[1] + reach), axis=1)
        for held in excluded:
            material = middle - reach * normal
            kept &= ~np.all((material > held[0]) & (material < held[1]), axis=1)
        for k in near:
            asked = np.flatnonzero(kept)
            kept[asked] = ~covered_by(parts[k], middle[asked], normal[asked], reach)
        corners = pieces[kept].reshape(-1, 3)
        rounded = np.round((corners - low) / (_SAME * max_edge)).astype(np.int64)
        _, first, index = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
        vertices.append(corners[first])
        triangles.append(count + index.reshape(-1, 3))
        owner.append(np.full(len(first), number))
        count += len(first)
    if not vertices:
        return Patch(np.empty((0, 3)), np.empty((0, 3), np.int64), np.empty(0, np.int64))
    return Patch(*(np.concatenate(values) for values in (vertices, triangles, owner)))


def _meet(one: np.ndarray, other: np.ndarray, reach: float) -> bool:
    return bool(np.all(one[0] <= other[1] + reach) and np.all(other[0] <= one[1] + reach))
