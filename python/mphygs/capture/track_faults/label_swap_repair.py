"""Labels that change places: markers that jump to where others were, while those jump to where they were.

Where a marker should be is told by where it was last seen and by how its neighbours, known by their places on
the object, have moved since; by how it moved itself where it has few. Those that are far from there are given
the labels that fit best (the assignment problem); they keep them where that is nearly all of what was off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from mphygs.capture.track_faults.tracks import ExaminedTracks, Finding, listed

FAULT = "label_swaps"
NEIGHBOURS = 8
# A marker jumps that is so many sigma from where it should be; labels are given anew where they leave at
# most this share of the square.
FAR, LEFT = 8.0, 0.1
# Frames after which a marker that jumped to where no other was is taken to be there.
BELIEVED = 3


def repair_label_swaps(tracks: ExaminedTracks) -> ExaminedTracks:
    """The tracks with every label where it belongs."""
    count = tracks.position.shape[1]
    if count < 3:
        return tracks
    order = _followed(tracks)
    position = np.take_along_axis(tracks.position, order[..., None], axis=1)
    whole = _at_rest(tracks, position)
    order, position = order[:, whole], position[:, whole]
    moved = order != np.arange(count)
    moved &= tracks.seen  # the label of a gap says nothing
    if not moved.any():
        return tracks
    text = f"labels are swapped and put right: {listed(_spans(moved))}"
    numbers = {"markers": int(moved.any(axis=0).sum()), "frames": int(moved.any(axis=1).sum())}
    return tracks.found(Finding(FAULT, text, numbers), position=position)


def _followed(tracks: ExaminedTracks) -> np.ndarray:
    """(T, M) which label of the file each marker has in each frame, followed from its first one on."""
    frames, count = tracks.position.shape[:2]
    seen = tracks.seen
    _, near = cKDTree(tracks.at).query(tracks.at, k=min(NEIGHBOURS + 1, count))
    last, gone = np.full((count, 3), np.nan), np.zeros((count, 3))
    doubted = np.zeros(count, int)  # frames since a jump
    order, kept = np.empty((frames, count), int), np.arange(count)
    for frame in range(frames):
        here = tracks.position[frame, kept]
        # Where a marker is not seen it is taken to move on with its neighbours; where these are few, each as
        # it did.
        change = here - last
        known = np.isfinite(change).all(axis=1)
        around = np.where(known[near][..., None], change[near], np.nan)[:, 1:]
        step = np.zeros((count, 3))
        told = known[near[:, 1:]].any(axis=1)
        if count > NEIGHBOURS:
            step[told] = np.nanmedian(around[told], axis=1)
        else:
            step = gone
        expected = last + step
        off = np.linalg.norm(here - expected, axis=1)
        jumped = np.flatnonzero(np.isfinite(off) & (off > _far(off, tracks.sigma)))
        if len(jumped) > 1:
            new = _assigned(here[jumped], expected[jumped], tracks.sigma)
            kept = kept.copy()
            kept[jumped] = kept[jumped[new]]
            here = tracks.position[frame, kept]
        order[frame] = kept
        off = np.linalg.norm(here - expected, axis=1)
        doubted = np.where(np.isfinite(off) & (off > _far(off, tracks.sigma)), doubted + 1, 0)
        sure = seen[frame, kept] & ((doubted == 0) | (doubted > BELIEVED))
        doubted[sure] = 0
        here = np.where(sure[:, None], here, expected)
        gone, last = np.nan_to_num(here - last), here
    return order


def _far(off: np.ndarray, sigma: float) -> float:
    """[m] that is a jump among distances (M,) from where markers should be."""
    known = off[np.isfinite(off)]
    return max(FAR * sigma, 4.0 * float(np.quantile(known, 0.25)) if len(known) else 0.0)


def _assigned(here: np.ndarray, expected: np.ndarray, sigma: float) -> np.ndarray:
    """(K,) which of the places (K, 3) each of the expected ones (K, 3) [m] has; its own where no other
    labels are clearly better."""
    square = ((expected[:, None] - here[None]) ** 2).sum(axis=2)
    _, new = linear_sum_assignment(square)
    own = np.arange(len(here))
    floor = 3.0 * (3.0 * sigma) ** 2  # what noise and a frame's motion may leave
    for cycle in _cycles(new):
        before, after = square[cycle, cycle].sum(), square[cycle, new[cycle]].sum()
        if len(cycle) > 1 and after < max(LEFT * before, len(cycle) * floor) and after < 0.5 * before:
            own[cycle] = new[cycle]
    return own


def _cycles(order: np.ndarray) -> list[np.ndarray]:
    """Index sets that a permutation maps to themselves."""
    found, left = [], set(range(len(order)))
    while left:
        cycle, k = [], min(left)
        while k in left:
            left.remove(k)
            cycle.append(k)
            k = int(order[k])
        found.append(np.array(cycle))
    return found


def _at_rest(tracks: ExaminedTracks, position: np.ndarray) -> np.ndarray:
    """(M,) labels of whole tracks by where they rest on the object, which a wrong first frame has swapped."""
    count = len(tracks.at)
    own = np.arange(count)
    first = np.nanargmax(np.isfinite(position[:10]).all(axis=2).sum(axis=1))
    rest = position[first]
    seen = np.flatnonzero(np.isfinite(rest).all(axis=1))
    if len(seen) < 3:
        return own
    off = np.linalg.norm(rest[seen] - tracks.at[seen], axis=1)
    jumped = seen[off > _far(off, tracks.sigma)]
    if len(jumped) > 1:
        own[jumped] = jumped[_assigned(rest[jumped], tracks.at[jumped], tracks.sigma)]
    return own


def _spans(moved: np.ndarray) -> list[str]:
    """Who is swapped, and when. moved: (T, M) bool."""
    groups: dict[tuple[int, int], list[int]] = {}
    for marker in np.flatnonzero(moved.any(axis=0)):
        frames = np.flatnonzero(moved[:, marker])
        groups.setdefault((int(frames[0]), int(frames[-1])), []).append(int(marker))
    return [
        f"markers {_joined(markers)} in frames {first} to {last}" for (first, last), markers in groups.items()
    ]


def _joined(markers: Sequence[int]) -> str:
    return listed([str(marker) for marker in markers], 6)
