"""Lines of rods cut into straight elements between nodes, with what of them a node carries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mphygs.synth.rod_section import Section

# Ends of lines that are nearer to each other than this are one [m].
SAME = 1e-9


@dataclass(frozen=True, eq=False)
class Line:
    """The middle of a rod, or of a piece of one. part: number of the part whose material it is; place: (n, 3)
    along it, dense [m]; section: of it."""

    part: int
    place: np.ndarray
    section: Section


@dataclass(frozen=True, eq=False)
class Net:
    """Nodes (N, 3) at rest [m]; element: (E, 2) their nodes; line: (E,) of which line each is; length: (E,)
    [m]; frame: (E, 3, 3), columns: along it and two across."""

    nodes: np.ndarray
    element: np.ndarray
    line: np.ndarray
    length: np.ndarray
    frame: np.ndarray


def rod_net(lines: Sequence[Line], boxes: np.ndarray, spacing: float) -> Net:
    """Elements no longer than `spacing` [m], ends of lines and edges of boxes (H, 2, 3) [m] at nodes."""
    places: list[np.ndarray] = []
    pairs, number = [], []
    for k, line in enumerate(lines):
        points = _divided(line.place, boxes, spacing)
        own = [_numbered(places, points[0])]
        for point in points[1:-1]:
            own.append(len(places))
            places.append(point)
        own.append(_numbered(places, points[-1]))
        pairs += list(zip(own[:-1], own[1:], strict=True))
        number += [k] * (len(own) - 1)
    nodes, element = np.array(places), np.array(pairs)
    step = nodes[element[:, 1]] - nodes[element[:, 0]]
    length = np.linalg.norm(step, axis=1)
    return Net(nodes, element, np.array(number), length, _frames(step / length[:, None]))


def _numbered(places: list[np.ndarray], point: np.ndarray) -> int:
    """The number of an end of a line, which another line may have already."""
    for k, known in enumerate(places):
        if np.linalg.norm(known - point) < SAME:
            return k
    places.append(point)
    return len(places) - 1


def _divided(place: np.ndarray, boxes: np.ndarray, spacing: float) -> np.ndarray:
    """(m, 3) along a polyline (n, 3), evenly between its ends and where it crosses the boxes' edges."""
    arc = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))]

    def at(s: np.ndarray) -> np.ndarray:
        return np.stack([np.interp(s, arc, place[:, c]) for c in range(3)], axis=1)

    cuts = [0.0, arc[-1]]
    for low, high in boxes:
        for axis in range(3):
            for edge in (low[axis], high[axis]):
                away = place[:, axis] - edge
                away[np.abs(away) < SAME] = 0.0
                crossed = np.flatnonzero(away[:-1] * away[1:] < 0.0)
                share = away[crossed] / (away[crossed] - away[crossed + 1])
                met = arc[crossed] + (arc[crossed + 1] - arc[crossed]) * share
                for cut in (*met, *arc[away == 0.0]):
                    point = at(np.array([cut]))[0]
                    if np.all((point >= low - SAME) & (point <= high + SAME)):
                        cuts.append(cut)
    cuts = np.unique(cuts)
    cuts = cuts[np.r_[True, np.diff(cuts) > SAME]]
    pieces = []
    for begin, end in zip(cuts[:-1], cuts[1:], strict=True):
        count = int(np.ceil((end - begin) / spacing - 1e-9))
        pieces.append(np.linspace(begin, end, count + 1)[:-1])
    return at(np.r_[np.concatenate(pieces), cuts[-1]])


def _frames(along: np.ndarray) -> np.ndarray:
    """(E, 3, 3) of unit vectors (E, 3): they are the first columns."""
    aside = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    return np.stack([along, aside, np.cross(along, aside)], axis=2)
