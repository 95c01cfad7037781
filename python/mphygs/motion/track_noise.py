"""How sure tracks are: how much they change with the cameras, and with what is expected of them.

The jackknife (Tukey 1958): with n cameras the variance of a track is (n - 1) / n times the sum of the squares
by which the tracks without one camera are off their mean. It sees what a camera sees wrongly by itself,
edges, shading, mixed-up petals, which residuals of one solution do not. What it cannot see is the pull of the
expectation that neighbours move alike, the same in all cameras: for this the square is added by which tracks
change where that is expected far less strictly.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from mphygs.capture.views import Photograph
from mphygs.motion.alignment import Aligner
from mphygs.motion.tracking import Followed

_LEVELS = ((1, 4),)
_LOOSER = 5.0  # times the standard deviations of what is expected of control points


def variance_of_tracks(
    aligner: Aligner,
    read: Callable[[int], Sequence[Photograph]],
    followed: Followed,
    chosen: np.ndarray,
    *,
    frames: Sequence[int],
    report: Callable[[int], object] | None = None,
) -> np.ndarray:
    """Variance a coordinate (F, M) [m^2] of the Gaussians `chosen` (M,) in each of `frames` (F,).

    report: is called with the number of frames that are done. Raises ValueError for fewer than two cameras.
    """
    variance = np.zeros((len(frames), len(chosen)))
    stiffness = aligner.rule.stiffness.times(_LOOSER)
    loose = Aligner(aligner.gaussians, aligner.graph, replace(aligner.rule, stiffness=stiffness))
    for index, frame in enumerate(frames):
        photographs = read(frame)
        expected = followed.expected(frame) if frame else followed.pose(0)
        if len(photographs) < 2:
            raise ValueError(f"{len(photographs)} camera; expected at least two, to leave one out")
        places = []
        for left_out in range(len(photographs)):
            others = [p for k, p in enumerate(photographs) if k != left_out]
            alignment = aligner.align(others, expected, start=followed.pose(frame), levels=_LEVELS)
            places.append(aligner.graph.carried(alignment.pose, chosen))
        away = np.stack(places) - np.mean(places, axis=0)
        share = (len(places) - 1) / len(places)
        variance[index] = share * (away**2).sum(axis=0).mean(axis=1)
        alone = loose.align(photographs, expected, start=followed.pose(frame), levels=_LEVELS).pose
        pulled = aligner.graph.carried(alone, chosen) - aligner.graph.carried(followed.pose(frame), chosen)
        variance[index] += (pulled**2).mean(axis=1)
        if report is not None:
            report(index + 1)
    return variance
