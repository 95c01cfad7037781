"""All faults that tracks show by themselves, in the order in which each helps the next to be seen."""

from __future__ import annotations

import numpy as np

from mphygs.capture.track_faults import (
    frame_drop_repair,
    label_swap_repair,
    marker_survey_repair,
    noise_level_repair,
    zero_gap_repair,
)
from mphygs.capture.track_faults.tracks import ExaminedTracks

BEYOND = 1e6  # [m]
REPAIRS = {
    zero_gap_repair.FAULT: zero_gap_repair.repair_zero_gaps,
    label_swap_repair.FAULT: label_swap_repair.repair_label_swaps,
    frame_drop_repair.FAULT: frame_drop_repair.repair_frame_drops,
    noise_level_repair.FAULT: noise_level_repair.repair_noise_level,
    marker_survey_repair.FAULT: marker_survey_repair.repair_marker_survey,
}


def repaired_tracks(tracks: ExaminedTracks) -> ExaminedTracks:
    """The tracks put right, with what was found; as they are where some are out of all reach, or nothing was
    measured, which is refused elsewhere."""
    if (np.abs(tracks.position) > BEYOND).any():
        return tracks
    for repair in REPAIRS.values():
        if not np.isfinite(tracks.position).all(axis=2).any():
            return tracks
        tracks = repair(tracks)
    return tracks
