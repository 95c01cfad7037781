"""From control points that were followed to tracks: of which Gaussians, when seen, how sure."""

from __future__ import annotations

import numpy as np

from mphygs.motion.alignment import Aligner
from mphygs.motion.control_graph import farthest_first
from mphygs.motion.stage_files import GaussianTracks
from mphygs.motion.tracking import Followed

_CAMERAS = 2  # that show a Gaussian in most of the frames in which a track of it is worth something
_OFTEN = 0.5  # of the frames
_LEAST_SIGMA = 1e-5  # of the object's extent


def chosen_gaussians(aligner: Aligner, followed: Followed, count: int) -> np.ndarray:
    """At most `count` (M,) of the Gaussians that are compared, well spread, in ascending order.

    Taken are those that two cameras or more show in half of the frames; where these are fewer than three,
    those that any camera does. Raises ValueError where none does.
    """
    often = (followed.cameras >= _CAMERAS).mean(axis=0) >= _OFTEN
    if often.sum() < 3:
        often = (followed.cameras >= 1).any(axis=0)
    if not often.any():
        raise ValueError("no camera shows the Gaussians where they went; expected pictures of them")
    candidates = aligner.chosen[often]
    if len(candidates) > count:
        candidates = candidates[farthest_first(aligner.graph.points[candidates], count)]
    return np.sort(candidates)


def tracks_of(
    aligner: Aligner, followed: Followed, chosen: np.ndarray, variance: np.ndarray
) -> GaussianTracks:
    """Tracks of Gaussians `chosen` (M,), NaN in frames where no camera shows them.

    variance: (F, M) a coordinate in some of the frames [m^2], see track_noise.py.
    """
    graph = aligner.graph
    seen = followed.cameras[:, np.searchsorted(aligner.chosen, chosen)] >= 1
    position = np.stack([graph.carried(followed.pose(f), chosen) for f in range(followed.frames)])
    quaternion = np.stack([graph.turns(followed.pose(f), chosen) for f in range(followed.frames)])
    position[~seen], quaternion[~seen] = np.nan, np.nan
    rest = graph.points[chosen]
    least = _LEAST_SIGMA * float(np.linalg.norm(np.ptp(rest, axis=0)))
    sigma = np.maximum(np.sqrt(variance.mean(axis=0)), least)
    return GaussianTracks(rest, position, sigma, quaternion, chosen)
