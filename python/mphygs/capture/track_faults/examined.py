"""All faults that tracks show by themselves, in the order in which each helps the next to be seen."""

from __future__ import annotations

import numpy as np

from mphygs.capture.track_faults import frame_drops, label_swaps, marker_survey, noise_level, zero_gaps
from mphygs.capture.track_faults.tracks import Tracks

BEYOND = 1e6  # [m]
CHECKS = (zero_gaps, label_swaps, frame_drops, noise_level, marker_survey)


def examined(tracks: Tracks) -> Tracks:
    """The tracks put right, with what was found; as they are where some are out of all reach, or nothing was
    measured, which is refused elsewhere."""
    if (np.abs(tracks.position) > BEYOND).any():
        return tracks
    for check in CHECKS:
        if not np.isfinite(tracks.position).all(axis=2).any():
            return tracks
        tracks = check.check(tracks)
    return tracks
