"""The state of an object in mid-motion, from its markers: where the paper's windows begin.

Between the markers displacement and velocity are interpolated by the smoothest field, a cubic radial function
with a linear part (Duchon's thin plate of this order; bending between two cross-sections with markers is
then that of a beam). What holds the object gives further points.
"""

from __future__ import annotations

import numpy as np
from scipy.interpolate import RBFInterpolator

from mphygs.capture.holds import Hold
from mphygs.compare.noise import Observation
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.transfer import Start

# Frames to either side that a marker's place and speed are taken from, and fewest of them.
REACH, FEWEST = 3, 5
FEWEST_MARKERS = 4
# Against noise: trust in a marker, in units of the radial function at the size of the object.
SMOOTHING = 1e-5
# Steps of differences: of a hold's motion [s], of the field in sizes of the object.
_POSE_STEP, _SLOPE_STEP = 1e-4, 1e-4


def start_at(predictor: Predictor, observation: Observation, frame: int) -> Start:
    """The state of all carriers at a frame.

    Raises ValueError where too few markers are seen about the frame.
    """
    recording, body = predictor.recording, predictor.body
    rest = predictor.attachment.anchor + predictor.attachment.offset
    free = predictor.attachment.hold < 0
    place, velocity, seen = _at_frame(observation, frame, recording.fps)
    seen &= free
    points = [rest[seen]]
    moved, speeds = [place[seen] - rest[seen]], [velocity[seen]]
    for hold, box in zip(recording.held, body.boxes, strict=True):
        corners = _corners(box, body.quadrature.points.reshape(-1, 3), predictor.settings.spacing)
        now, speed = _carried(hold, corners, frame / recording.fps, recording.fps)
        points.append(corners)
        moved.append(now - corners)
        speeds.append(speed)
    if seen.sum() < FEWEST_MARKERS:
        raise ValueError(
            f"--schedule paper: sequence '{recording.name}' shows {int(seen.sum())} markers about frame "
            f"{frame}; expected at least {FEWEST_MARKERS}, to begin a window there"
        )
    at = predictor.transfer.places_at_rest()
    known = np.concatenate(points)
    size = float(np.linalg.norm(np.ptp(known, axis=0)))
    values = np.concatenate([np.concatenate(moved), np.concatenate(speeds)], axis=1)
    try:
        field = RBFInterpolator(known / size, values, kernel="cubic", degree=1, smoothing=SMOOTHING)
    except np.linalg.LinAlgError as error:
        raise ValueError(
            f"--schedule paper: the markers of sequence '{recording.name}' at frame {frame} lie in one "
            "plane; expected some beside it, to begin a window there"
        ) from error
    found = field(at / size)
    steps = _SLOPE_STEP * np.eye(3)
    apart = [field(at / size + step)[:, :3] - field(at / size - step)[:, :3] for step in steps]
    gradient = np.stack(apart, axis=2) / (2 * _SLOPE_STEP * size)
    return predictor.transfer.admissible(
        Start(frame, found[:, :3], found[:, 3:], gradient),
        lambda h, x: _carried(recording.held[h], x, frame / recording.fps, recording.fps),
    )


def _at_frame(observation: Observation, frame: int, fps: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Place (M, 3) [m] and velocity (M, 3) [m/s] of every marker, and (M,) whether it is seen well enough.

    By the cubic through the frames around, as many as are seen.
    """
    first, last = max(frame - REACH, 0), min(frame + REACH + 1, len(observation.position))
    times = (np.arange(first, last) - frame) / fps
    seen = observation.observed[first:last]
    good = seen.sum(0) >= FEWEST
    place, velocity = np.zeros((2, *observation.position.shape[1:]))
    for m in np.flatnonzero(good):
        powers = times[seen[:, m], None] ** np.arange(4)
        found = np.linalg.lstsq(powers, observation.position[first:last, m][seen[:, m]], rcond=None)[0]
        place[m], velocity[m] = found[0], found[1]
    return place, velocity, good


def _corners(box: np.ndarray, points: np.ndarray, least: float) -> np.ndarray:
    """(8, 3) corners of a hold's box as far as the object's points (N, 3) go, at least so thick [m]."""
    low = np.clip(box[0], points.min(0), points.max(0))
    high = np.clip(box[1], points.min(0), points.max(0))
    middle, half = 0.5 * (low + high), np.maximum(0.5 * (high - low), 0.5 * least)
    return middle + half * (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1.0)


def _carried(hold: Hold, points: np.ndarray, time: float, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """Places and velocities of points (K, 3) [m] that a hold carries, at a time [s]."""
    rotation, position = hold.poses(time + _POSE_STEP * np.array([0.0, 1.0, -1.0]), fps)
    now, later, before = np.einsum("tij,kj->tki", rotation, points) + position[:, None]
    return now, (later - before) / (2 * _POSE_STEP)
