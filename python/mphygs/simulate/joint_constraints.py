"""Rows that tie the grids of two parts along a joint: patterns of the jump between them are kept at zero."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.sparse import coo_matrix

from mphygs.scene.particles import Joint

# Patterns finer than this many spacings are left to the parts' own stiffness: to tie every value of two
# splines of one spacing would stiffen the joint.
HAT = 2.0
# A side below so many spacings, in standard deviations, is thin: along it the hats do not change.
THIN = 0.15
# A further pattern counts where this share of its square is not in those before it.
LEAST_NEW = 1e-2
# Of a joint's longest side, squared: its height counts where it is not nearly flat, its width always.
LEAST_HEIGHT, LEAST_WIDTH = 2e-2, 1e-8


def patterns(joint: Joint, spacing: float) -> np.ndarray:
    """(Q, K) values of the patterns, orthonormal with the weights area / sum of area.

    The moments of order 0 and 1 carry the joint's force and its torque, the mixed ones of order 2 its saddle;
    hats two spacings wide, one of them in the middle, follow where it is larger than they, by themselves and
    times the distance across a thin side, which bends a sheet.
    """
    weight = joint.area / joint.area.sum()
    arm = joint.points - weight @ joint.points
    square, axes = np.linalg.eigh((weight[:, None] * arm).T @ arm)
    across = weight @ (joint.normal @ axes) ** 2 < 0.5
    least = np.where(across, LEAST_WIDTH, LEAST_HEIGHT)
    used = (square > least * square.max()) & (square > 1e-12 * spacing**2)
    linear = [arm @ axes[:, k] / np.sqrt(square[k]) for k in np.flatnonzero(used)[::-1]]
    kept = _extended([], np.ones((len(weight), 1)), weight)
    for column in linear:
        kept = _extended(kept, column[:, None], weight)
    # Along the grid's axes, as in a cell: principal ones are not defined on a square.
    mixed = np.stack([arm[:, a] * arm[:, b] for a, b in combinations(range(3), 2)], axis=1)
    if len(linear) > 1:
        kept = _extended(kept, mixed, weight)
    hats = _hats(arm, spacing)
    kept = _extended(kept, hats, weight)
    for k in np.flatnonzero(used & across & (square < (THIN * spacing) ** 2)):
        kept = _extended(kept, hats * (arm @ axes[:, k] / np.sqrt(square[k]))[:, None], weight)
    return np.stack(kept, axis=1)


def _hats(arm: np.ndarray, spacing: float) -> np.ndarray:
    """(Q, H) trilinear hats about the origin that are not zero on all points (Q, 3)."""
    place = arm / (HAT * spacing)
    low = np.floor(place).astype(int)
    corner, column = np.unique(
        np.concatenate([low + step for step in np.indices((2, 2, 2)).reshape(3, -1).T]), axis=0,
        return_inverse=True,
    )  # fmt: skip
    out = np.zeros((len(arm), len(corner)))
    row = np.tile(np.arange(len(arm)), 8)
    np.add.at(
        out,
        (row, column.ravel()),
        np.maximum(1.0 - np.abs(place[row] - corner[column.ravel()]), 0.0).prod(1),
    )
    return out


def _extended(kept: list[np.ndarray], more: np.ndarray, weight: np.ndarray) -> list[np.ndarray]:
    """Orthonormal patterns with what `more` (Q, H) adds to them."""
    largest = (weight @ more**2).max()
    for known in kept:
        more = more - np.outer(known, (weight * known) @ more)
    for known in kept:  # once more, for the digits that the first time lost
        more = more - np.outer(known, (weight * known) @ more)
    strength, mix = np.linalg.eigh((weight[:, None] * more).T @ more)
    new = [
        more @ mix[:, k] / np.sqrt(strength[k])
        for k in range(len(strength))[::-1]
        if strength[k] > LEAST_NEW * largest
    ]
    return [*kept, *new]


def tie_rows(
    joints: Sequence[Joint],
    weights: Sequence[tuple[tuple[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]],
    spacing: float,
) -> list[tuple[int, np.ndarray, np.ndarray]]:
    """(joint, node (W, 3), weight (W,)) of every row.

    weights: for each joint and each of its two parts the nodes (Q, 27, 3) and shares (Q, 27) that carry the
    joint's points, taken as the part's own material. Row k is the integral of pattern k times the jump,
    first part less second, over the joint, per area.
    """
    rows = []
    for number, (joint, sides) in enumerate(zip(joints, weights, strict=True)):
        pattern = patterns(joint, spacing)
        factor = (joint.area / joint.area.sum())[:, None] * pattern
        node, value = [], []
        for sign, (nodes, shares) in zip((1.0, -1.0), sides, strict=True):
            index, column = np.unique(nodes.reshape(-1, 3), axis=0, return_inverse=True)
            column = column.reshape(shares.shape)
            row = np.repeat(np.arange(len(shares)), shares.shape[1])
            carried = coo_matrix((shares.ravel(), (row, column.ravel())), shape=(len(shares), len(index)))
            node.append(index)
            value.append(sign * (carried.T @ factor).T)
        nodes, values = np.concatenate(node), np.concatenate(value, axis=1)
        rows += [(number, nodes, row) for row in values]
    return rows
