"""A capture in pictures as one of parts and tracks, from the files of its stages.

What fits markers then fits tracks: the parts are the segments' meshes, the holds those of the capture or of
the contact stage, the markers a selection of the tracks. A sequence is told in the object's own frame, as it
stands in frame 0, so that every run begins at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mphygs.capture.actuators import Actuator, Force, Tendon
from mphygs.capture.checks import check_capture
from mphygs.capture.errors import fault
from mphygs.capture.format import Capture
from mphygs.capture.holds import Hold
from mphygs.capture.markers import Markers
from mphygs.capture.meshes import Part
from mphygs.capture.record import Sequence as Recording
from mphygs.capture.rotation import matrix_from_quaternion, quaternion_from_matrix
from mphygs.capture.stages import StageFolder
from mphygs.fit.boundary_share import found_boundary
from mphygs.fit.stage_particles import particles_of
from mphygs.motion.control_graph import farthest_first
from mphygs.motion.stage_files import Tracks, read_stage_hold, read_tracks
from mphygs.scene.object_files import read_parts

TRACK_COUNT = 250
# Of the frames that are used, a track must be seen in so many to be chosen; of the median sigma, the largest.
LEAST_SEEN, LARGEST_SIGMA = 0.5, 3.0
# How errors of tracks last where nothing held shows it, and at most.
USUAL_MEMORY, USUAL_LASTING, LARGEST_MEMORY = 0.95, 0.9, 0.97
_FEWEST_HELD = 3
# The middle of a part: so large a share of its particles is not as deep in it.
INNERMOST = 0.95


@dataclass(frozen=True, eq=False)
class Placement:
    """Where a sequence's frame 0 has the object: world = rotation @ rest + position, (3, 3) and (3,) [m]."""

    rotation: np.ndarray
    position: np.ndarray

    def of_world(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the world in the object's frame."""
        return (points - self.position) @ self.rotation

    def to_world(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) of the object's frame in the world."""
        return points @ self.rotation.T + self.position


def is_pictured(capture: Capture) -> bool:
    """Whether the object is given by pictures or Gaussians alone, so that stages have to find its parts."""
    return not capture.parts and (capture.views is not None or capture.gaussians is not None)


def assembled_capture(capture: Capture, stages: Path, *, tracked: bool = True) -> Capture:
    """The capture with parts, holds and tracks of its stages. tracked: False leaves the tracks out.

    Sequences without a hold, or without tracks, stay without. Raises CaptureError, one line, for files of
    stages that cannot be used, and where they contradict the capture.
    """
    files = StageFolder(stages)
    parts = capture.parts or tuple(replace(part, shape=capture.found_as) for part in _parts(files))
    sequences = tuple(_assembled_sequence(r, files, parts, tracked) for r in capture.sequences)
    whole = replace(capture, parts=parts, sequences=sequences)
    check_capture(whole)
    return whole


def _parts(files: StageFolder) -> tuple[Part, ...]:
    parts = read_parts(files.parts)
    if not files.particles.is_file():
        return tuple(parts)
    particles = particles_of(files.folder, len(parts))
    found = []
    for number, part in enumerate(parts):
        depth = -particles.signed_distance[particles.inside & (particles.label == number)]
        thickness = 2.0 * float(np.quantile(depth, INNERMOST)) if len(depth) else 0.0
        found.append(replace(part, boundary=found_boundary(thickness, particles.resolution)))
    return tuple(found)


def as_one_part(capture: Capture) -> Capture:
    """The capture with all its parts as one: what a homogeneous model sees."""
    first = np.cumsum([0, *(len(part.vertices) for part in capture.parts)])
    vertices = np.concatenate([part.vertices for part in capture.parts])
    faces = np.concatenate([p.faces + k for p, k in zip(capture.parts, first[:-1], strict=True)])
    known = capture.known
    ratio = known.poissons_ratio
    if isinstance(ratio, dict):
        ratio = float(np.mean(list(ratio.values()))) if ratio else None
    mass = known.mass
    if mass is None and set(known.density) == {p.name for p in capture.parts}:
        mass = sum(known.density[p.name] * p.volume for p in capture.parts)
    one = replace(known, density={}, poissons_ratio=ratio, mass=mass)
    boundary = max(part.boundary for part in capture.parts)
    return replace(capture, parts=(Part("object", vertices, faces, boundary),), known=one)


def placement_of(recording: Recording, stages: Path) -> Placement:
    """Where a sequence of the capture as it was recorded begins: by the pose of its first hold."""
    held = _held(recording, StageFolder(stages))
    if not held or held[0].is_fixed:
        return Placement(np.eye(3), np.zeros(3))
    rotation, position = held[0].poses(np.zeros(1), recording.fps)
    return Placement(rotation[0], position[0])


def _held(recording: Recording, files: StageFolder) -> tuple[Hold, ...]:
    """What holds the object: as the capture says, else as the contact stage found."""
    path = files.hold(recording.name)
    if recording.held or not path.is_file():
        return recording.held
    return (read_stage_hold(path, frames=recording.frames),)


def _acting_from_frame(actuator: Actuator, placement: Placement) -> Actuator:
    """What pulls, where it is told in the world: the direction of a force, the place of an anchor."""
    if isinstance(actuator, Force):
        return replace(actuator, values=actuator.values @ placement.rotation)
    if isinstance(actuator, Tendon) and actuator.anchor is not None:
        return replace(actuator, anchor=placement.of_world(actuator.anchor))
    return actuator


def _assembled_sequence(
    recording: Recording, files: StageFolder, parts: tuple[Part, ...], tracked: bool
) -> Recording:
    placement = placement_of(recording, files.folder)
    held = tuple(_from_frame(hold, placement) for hold in _held(recording, files))
    upright = np.array_equal(placement.rotation, np.eye(3))
    # What is told along the axes of the world turns into the frame of the sequence.
    sensors = tuple(replace(s, value=s.value @ placement.rotation) for s in recording.sensors)
    loads = tuple(replace(d, force=np.asarray(d.force, float) @ placement.rotation) for d in recording.loads)
    actuators = tuple(_acting_from_frame(a, placement) for a in recording.actuators)
    turn = None if upright else placement.rotation
    recording = replace(
        recording, held=held, turn=turn, sensors=sensors, loads=loads, actuators=actuators
    )
    path = files.tracks(recording.name)
    if recording.markers is not None or not tracked or not path.is_file():
        return recording
    tracks = read_tracks(path, frames=recording.frames)
    tracks = replace(tracks, position=placement.of_world(tracks.position))
    size = float(np.linalg.norm(np.ptp(np.concatenate([p.bounds for p in parts]), axis=0)))
    chosen = _chosen(path, recording, tracks, size)
    return replace(recording, markers=_markers(recording, chosen))


def _from_frame(hold: Hold, placement: Placement) -> Hold:
    """A hold whose poses are told in the object's frame of a sequence."""
    if hold.position is None or hold.quaternion is None:
        return hold
    rotation = placement.rotation.T @ matrix_from_quaternion(hold.quaternion)
    return replace(
        hold, position=placement.of_world(hold.position), quaternion=quaternion_from_matrix(rotation)
    )


def _used(recording: Recording) -> np.ndarray:
    """(T,) bool, frames to fit or to predict; all where there are none."""
    used = np.zeros(recording.frames, bool)
    for first, last in (recording.fit, recording.predict):
        used[first:last] = True
    return used if used.any() else ~used


def _chosen(path: Path, recording: Recording, tracks: Tracks, size: float) -> Tracks:
    """Tracks that are seen long enough, as far from one another at rest as can be."""
    seen = np.isfinite(tracks.position).all(2)[_used(recording)].mean(0)
    good = (seen >= LEAST_SEEN) & (tracks.sigma <= LARGEST_SIGMA * np.median(tracks.sigma))
    if good.sum() < _FEWEST_HELD:
        share = f"{100 * LEAST_SEEN:.0f} %"
        raise fault(str(path), f"has {int(good.sum())} tracks seen in {share} of the frames", "at least 3")
    number = np.flatnonzero(good)
    order = farthest_first(tracks.rest[number], min(TRACK_COUNT, len(number)), from_middle=True)
    number = np.sort(number[order])
    away = np.nanmedian(np.linalg.norm(tracks.position[0, number] - tracks.rest[number], axis=1))
    if away > 0.5 * size:
        raise fault(
            f"{path}: position", f"begins {away:.3g} m from rest", "points in m in the object's frame"
        )
    return Tracks(tracks.rest[number], tracks.position[:, number], tracks.sigma[number])


def _markers(recording: Recording, tracks: Tracks) -> Markers:
    """Tracks as markers. Those on what is held show how far to trust all, and how long errors last."""
    errors = _held_errors(recording, tracks)
    factor, memory, lasting = 1.0, USUAL_MEMORY, USUAL_LASTING
    if errors.shape[1] >= _FEWEST_HELD:
        scaled = errors / tracks.sigma[_held_tracks(recording, tracks)][:, None]
        factor = max(1.0, float(np.sqrt(np.nanmean(scaled**2))))
        near, far = _correlation(scaled, 1), _correlation(scaled, 2)
        # of an error that lasts and one that does not: near = lasting memory, far = lasting memory^2
        memory = float(np.clip(far / near, near, LARGEST_MEMORY)) if near > 0.0 else 0.0
        lasting = min(near / memory, 1.0) if memory > 0.0 else 0.0
    spread = factor * tracks.sigma
    sigma = float(np.sqrt(np.mean(spread**2)))
    return Markers(tracks.position, tracks.rest, sigma, spread=spread, memory=memory, lasting=lasting)


def _correlation(errors: np.ndarray, lag: int) -> float:
    """Correlation, at least 0, of errors (T, H, 3) so many frames apart; 0 where there are none."""
    one, other = errors[lag:], errors[:-lag]
    both = np.isfinite(one * other)
    scale = float(np.sqrt(np.sum(one[both] ** 2) * np.sum(other[both] ** 2)))
    return max(float(one[both] @ other[both]) / scale, 0.0) if scale > 0 else 0.0


def _held_tracks(recording: Recording, tracks: Tracks) -> np.ndarray:
    """(M,) bool, tracks that the first hold carries."""
    if not recording.held:
        return np.zeros(len(tracks.rest), bool)
    box = recording.held[0].box
    return ((tracks.rest >= box[0]) & (tracks.rest <= box[1])).all(1)


def _held_errors(recording: Recording, tracks: Tracks) -> np.ndarray:
    """(T, H, 3) [m], how far tracks on the first hold are from where it carries them."""
    held = _held_tracks(recording, tracks)
    if not held.any():
        return np.zeros((recording.frames, 0, 3))
    times = np.arange(recording.frames) / recording.fps
    rotation, position = recording.held[0].poses(times, recording.fps)
    carried = np.einsum("tij,mj->tmi", rotation, tracks.rest[held]) + position[:, None]
    return tracks.position[:, held] - carried
