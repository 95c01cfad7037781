"""From a capture's parts to a body: the material in cells, its surface, and what holds and ties it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.meshes import Part
from mphygs.scene.curved_charts import Chart
from mphygs.scene.fastenings import grading
from mphygs.scene.particles import (
    HoldFace,
    chosen_shape,
    exposed_surface,
    fill,
    fill_each,
    hold_face,
    lay_chart,
    rods_doubled,
)
from mphygs.scene.slivers import merge_slivers
from mphygs.scene.spacing_worth import usual_spacing
from mphygs.simulate.body import LANES, Body
from mphygs.simulate.rows import constraint_rows

# Cells filled less than this hand their material to a neighbour.
SMALLEST_SHARE = 0.1
# Cells filled less than this have shapes that their points do not see: springs hold those, but for parts that
# fill less of their cells on average: flowers with petals far thinner than a cell fitted worse with them.
SPARSE, THINNEST = 0.5, 1.0 / 3.0
# So do all cells of a bar that has so many to a section: no neighbour holds what their points do not see.
NARROW = 2


def discretise(
    capture: Capture,
    boxes: np.ndarray,
    spacing: float,
    *,
    places: np.ndarray | None = None,
    fitting: bool = True,
) -> Body:
    """Discretise a capture's parts for given hold boxes.

    boxes: (H, 2, 3) [m]; spacing: of the grids [m]; places: (K, 3) points for effects at a place [m];
    fitting: every part's grid fits its material (see `mphygs.scene.quadrature.fill_each`), else all stand
    alike.
    Raises ValueError where a hold touches no free material, the spacing misses a part, or a part hangs on
    nothing.
    """
    parts = capture.parts
    faces = [
        hold_face(parts, box, spacing=spacing, other_boxes=np.delete(boxes, h, axis=0))
        for h, box in enumerate(boxes)
    ]
    excluded = boxes if len(boxes) else None
    # A held face on the boundary between two cells leaves no slivers of material beside it.
    if fitting:
        gripped = {
            (int(p), face.axis): face.coordinate for group in faces for face in group for p in set(face.part)
        }
        charts = _charts(parts, spacing, faces)
        charts = charts if any(chart is not None for chart in charts) else []
        quadrature = fill_each(parts, spacing=spacing, exclude_boxes=excluded, planes=gripped, charts=charts)
    else:
        for part in parts:
            if (shape := chosen_shape(part, spacing)[0]) != "solid":
                raise ValueError(
                    f"part '{part.name}': a {shape} is simulated by the total-Lagrangian transfer alone, "
                    'expected --transfer total-lagrangian, or "as": "solid"'
                )
        low = np.min([part.vertices.min(0) for part in parts], axis=0)
        offset = np.zeros(3)
        for group in faces:
            for face in group:
                offset[face.axis] = ((face.coordinate - low[face.axis]) / spacing) % 1.0
        quadrature = fill(parts, spacing=spacing, exclude_boxes=excluded, origin_offset=offset)
    quadrature = rods_doubled(merge_slivers(quadrature, share=SMALLEST_SHARE))
    centroid = np.array(
        [
            np.average(
                quadrature.points[quadrature.part == p].reshape(-1, 3),
                axis=0,
                weights=quadrature.volumes[quadrature.part == p].ravel(),
            )
            if (quadrature.part == p).any()
            else part.vertices.mean(0)
            for p, part in enumerate(parts)
        ]
    )
    # Every part has nodes of its own: one spline over a joint of stiff and soft would stiffen the soft side
    # for a spacing around. Beyond its nodes two columns stay free, so that no stencil reaches the next grid.
    width = int(quadrature.node_shape[0]) + 2 if len(parts) > 1 else 0
    numbered = quadrature.cell.copy()
    numbered[:, 0] += quadrature.part * width
    filled = quadrature.filled
    cells = np.bincount(quadrature.part, minlength=len(parts))
    thick = np.bincount(quadrature.part, filled, len(parts)) > THINNEST * cells
    narrow = np.array(
        [
            quadrature.chart(p) is None and _section(quadrature.cell[quadrature.part == p]) <= NARROW
            for p in range(len(parts))
        ]
    )
    sparse = (filled < SPARSE) | narrow[quadrature.part]
    geometry = {
        "origin": quadrature.origins,
        "spacing": quadrature.spacings,
        "grid_width": width,
        "cell": numbered,
        "part": quadrature.part,
        "points": quadrature.points,
        "volume": quadrature.volumes,
        "sparse": np.where(sparse & thick[quadrature.part], filled, 0.0),
        "part_count": len(parts),
    }
    geometry.update(_curved_nodes(quadrature.charts, width))
    body = Body(quadrature, geometry, boxes, tuple(p.name for p in parts), centroid, parts)
    geometry.update(_surface(body, boxes, spacing))
    geometry.update(constraint_rows(body, faces, spacing, carried=fitting))
    geometry["hold_centre"] = boxes.mean(axis=1)
    if places is not None and len(places):
        geometry["places"] = np.asarray(places, float)
        geometry["place_cell"] = body.nearest_cell(np.asarray(places, float))
    return body


def _charts(
    parts: Sequence[Part], spacing: float, faces: Sequence[Sequence[HoldFace]]
) -> list[Chart | None]:
    """The curved grid of every part, None where it is a solid."""
    found: list[Chart | None] = []
    for number, part in enumerate(parts):
        gripped = [f.points[f.part == number] for group in faces for f in group]
        sheet = chosen_shape(part, spacing)[0] == "shell"
        graded = grading(parts, number, usual_spacing(parts), gripped) if sheet else None
        found.append(lay_chart(part, spacing, gripped, graded))
    return found


def _curved_nodes(charts: tuple[Chart | None, ...], width: int) -> dict:
    """Where nodes stand that a chart has, numbered over all grids."""
    curved = [(number, chart) for number, chart in enumerate(charts) if chart is not None]
    if not curved:
        return {}
    nodes = [chart.nodes + [number * width, 0, 0] for number, chart in curved]
    return {
        "curved_node": np.concatenate(nodes).astype(np.int32),
        "curved_position": np.concatenate([chart.control.reshape(-1, 3) for _, chart in curved]),
    }


def _section(cell: np.ndarray) -> int:
    """Cells of a part across its longest axis. cell: (B, 3) its cells."""
    if len(cell) == 0:
        return 0
    count = np.ptp(cell, axis=0) + 1
    return int(np.prod(count) // count.max())


def _surface(body: Body, boxes: np.ndarray, spacing: float) -> dict:
    """Exposed surface, one block to a cell: the samples in each eighth of it stand together in one lane.

    Area and centroid of every eighth are kept, so forces that vary within a quarter of a spacing are
    averaged there; lanes without surface have no area.
    """
    samples = exposed_surface(body.parts, max_edge=spacing / 2, exclude_boxes=boxes if len(boxes) else None)
    if not len(samples.area):
        return {}
    cells, block = np.unique(
        body.nearest_cell(samples.points, samples.part), axis=0, return_inverse=True
    )
    block = block.ravel()
    centre = _centres(body, cells)
    above = samples.points > centre[block]
    for part, chart in enumerate(body.quadrature.charts):
        if chart is not None and (mine := samples.part == part).any():
            above[mine] = chart.to_cells(samples.points[mine]) > body.standing(cells[block[mine]])[0]
    octant = above @ np.array([4, 2, 1])
    lane = block * LANES + octant
    area = np.bincount(lane, samples.area, minlength=LANES * len(cells))
    sums = [np.bincount(lane, samples.area * samples.points[:, c], minlength=len(area)) for c in range(3)]
    points = np.stack(sums, axis=1) / np.where(area > 0, area, 1.0)[:, None]
    points = np.where((area > 0)[:, None], points, np.repeat(centre, LANES, axis=0))
    return {
        "surface_cell": cells.astype(np.int32),
        "surface_points": points.reshape(-1, LANES, 3),
        "surface_area": area.reshape(-1, LANES),
    }


def _centres(body: Body, cells: np.ndarray) -> np.ndarray:
    """Middle of cells (C, 3), numbered over all grids [m]."""
    own, part = body.standing(cells)
    q = body.quadrature
    centre = q.origins[part] + own * q.spacings[part]
    for number, chart in enumerate(q.charts):
        if chart is not None and (mine := part == number).any():
            centre[mine] = chart.to_space(own[mine].astype(float))
    return centre
