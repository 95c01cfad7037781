"""Closed convex prisms and blocks of cubes."""

from __future__ import annotations

import numpy as np

from mphygs.capture.meshes import Part


def prism(name: str, outline: np.ndarray, axis: int, low: float, high: float) -> Part:
    """A convex prism. outline: (K, 2) [m], counter-clockwise in the axes after `axis`; low, high: [m]."""
    count = len(outline)
    vertices = np.empty((2 * count, 3))
    for end, coordinate in enumerate((low, high)):
        rows = vertices[end * count : (end + 1) * count]
        rows[:, axis] = coordinate
        rows[:, (axis + 1) % 3], rows[:, (axis + 2) % 3] = outline.T
    faces = []
    for k in range(1, count - 1):
        faces += [(0, k + 1, k), (count, count + k, count + k + 1)]
    for k in range(count):
        following = (k + 1) % count
        faces += [(k, following, count + following), (k, count + following, count + k)]
    return Part(name, vertices, np.array(faces, dtype=np.int64))


def blocks(name: str, cells: np.ndarray, size: float, origin: np.ndarray) -> Part:
    """The outer faces of equal cubes. cells: (N, 3) whole numbers; size: of a cube, origin: (3,) [m]."""
    filled = {tuple(c) for c in cells.tolist()}
    corners: dict[tuple[int, ...], int] = {}
    faces = []
    for cell in sorted(filled):
        for axis in range(3):
            for end in (0, 1):
                beside = list(cell)
                beside[axis] += 2 * end - 1
                if tuple(beside) in filled:
                    continue
                square = np.tile(cell, (4, 1))
                square[:, axis] += end
                square[[1, 2], (axis + 1) % 3] += 1
                square[[2, 3], (axis + 2) % 3] += 1
                a, b, c, d = (corners.setdefault(tuple(q), len(corners)) for q in square.tolist())
                faces += [(a, b, c), (a, c, d)] if end else [(a, c, b), (a, d, c)]
    vertices = np.asarray(origin, float) + size * np.array(list(corners), float)
    return Part(name, vertices, np.array(faces, dtype=np.int64))


def rectangle(width: float, height: float) -> np.ndarray:
    """(4, 2) corners about the origin [m]."""
    return 0.5 * np.array([[-width, -height], [width, -height], [width, height], [-width, height]])


def polygon(apothem: float, sides: int) -> np.ndarray:
    """(sides, 2) corners of a regular polygon with sides across the axes; `sides`: a multiple of 4."""
    angle = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    return apothem / np.cos(np.pi / sides) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
