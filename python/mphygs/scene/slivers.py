"""Cells with little material hand it to a neighbour, so that no node hangs on a sliver."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from mphygs.scene.quadrature import Quadrature

_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
_NEIGHBOURS = np.array([d for d in product((-1, 0, 1), repeat=3) if any(d)], np.int32)


def merge_slivers(quadrature: Quadrature, *, share: float) -> Quadrature:
    """Join blocks that fill less than `share` of their cell with a neighbouring block of the same part.

    A node that only a sliver touches has next to no mass and stiffness; its motion means nothing and can
    invert the sliver. The joint block has the moments of order 0, 1 and 2 of both materials; some of
    its points lie beyond the cell's boundary, where the cell's own polynomial carries them. Slivers
    are joined smallest first to the neighbour with the most material, face neighbours preferred;
    one without any neighbour of its part stays.
    """
    least = share * quadrature.cell_volume
    volume = quadrature.volumes.sum(1)
    points = quadrature.points.copy()
    curved = [number for number, chart in enumerate(quadrature.charts) if chart is not None]
    for number in curved:  # told in cells, where neighbours of a bent sheet lie beside each other
        mine = quadrature.part == number
        points[mine] = quadrature.in_cells(points[mine], number)
    mean = points.mean(1)
    deviation = points - mean[:, None]
    covariance = np.einsum("bqi,bqj->bij", deviation, deviation) / 8.0
    index = {
        (int(p), *map(int, c)): b
        for b, (p, c) in enumerate(zip(quadrature.part, quadrature.cell, strict=True))
    }
    volume, alive = volume.copy(), np.ones(len(volume), bool)
    changed = np.zeros(len(volume), bool)
    order = np.argsort(volume, kind="stable")
    for block in order[volume[order] < least[order]]:
        if volume[block] >= least[block]:
            continue  # it took in a smaller one
        best, target = 0.0, -1
        for step in _NEIGHBOURS:
            key = (int(quadrature.part[block]), *map(int, quadrature.cell[block] + step))
            other = index.get(key, -1)
            if other < 0 or not alive[other]:
                continue
            worth = volume[other] / float(np.abs(step).sum())
            if worth > best:
                best, target = worth, other
        if target < 0:
            continue
        total = volume[block] + volume[target]
        a, b = volume[block] / total, volume[target] / total
        gap = mean[block] - mean[target]
        covariance[target] = a * covariance[block] + b * covariance[target] + a * b * np.outer(gap, gap)
        mean[target] = a * mean[block] + b * mean[target]
        volume[target] = total
        alive[block], changed[target] = False, True
    points, volumes = quadrature.points.copy(), quadrature.volumes.copy()
    for block in np.flatnonzero(changed & alive):
        value, axes = np.linalg.eigh(covariance[block])
        root = axes @ np.diag(np.sqrt(np.maximum(value, 0.0))) @ axes.T
        points[block] = mean[block] + _CORNERS @ root
        if quadrature.part[block] in curved:
            points[block] = quadrature.from_cells(points[block], int(quadrature.part[block]))
        volumes[block] = volume[block] / 8.0
    return replace(
        quadrature,
        cell=quadrature.cell[alive],
        part=quadrature.part[alive],
        points=points[alive],
        volumes=volumes[alive],
    )
