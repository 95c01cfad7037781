"""Measured markers of one sequence with the noise that they carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from mphygs.capture.markers import Markers
from mphygs.capture.record import Sequence
from mphygs.capture.track_faults.scatter import SeenSigma, own_noise, seen_sigma
from mphygs.compare.autoregression import Autoregression
from mphygs.compare.masked_means import mean_seen
from mphygs.compare.noise_course import noise_course
from mphygs.compare.sensor_residuals import SensorObservation, sensor_observations
from mphygs.compare.whitening import MINIMUM_REST_FRAMES, NoiseModel, Whitener, noise_from_rest
from mphygs.simulate.body import Attachment

# Two ways of telling noise from motion agree where the second says so much of what the first does.
ALIKE = 0.9
# Without a stated sigma and without rest footage: what good marker systems reach.
DEFAULT_SIGMA = 2e-4
# Of an error that stays, what is carried from frame to frame.
STAYS = 0.995


@dataclass(frozen=True, eq=False)
class Observation:
    """position: (T, M, 3) [m], NaN where missing; noise: of one coordinate.

    weight: (M,) 1 for markers in use, 0 for markers left out as outliers; stated: sigma of the capture [m];
    seen_sigma: what the tracks show of it, where that is used; sensors: what other instruments measured;
    course: (T,) what the noise is multiplied by, frame by frame, of root mean square 1, None where it is the
    same in all.
    """

    position: np.ndarray
    noise: NoiseModel
    weight: np.ndarray
    stated: float | None = None
    seen_sigma: SeenSigma | None = None
    sensors: tuple[SensorObservation, ...] = ()
    course: np.ndarray | None = None
    _whiteners: dict = field(default_factory=dict, init=False, repr=False)

    @property
    def observed(self) -> np.ndarray:
        """(T, M) bool: measured, and not left out."""
        return np.isfinite(self.position).all(2) & (self.weight > 0)

    def whitener(self, first: int, last: int) -> Whitener:
        """Whitening of frames [first, last)."""
        key = (first, last)
        if key not in self._whiteners:
            course = self.frames_of_noise[first:last]
            self._whiteners[key] = Whitener(self.noise, self.observed[first:last], course=course)
        return self._whiteners[key]

    @property
    def sigma(self) -> float:
        """Standard deviation of one coordinate, everything included, root mean square over markers [m]."""
        return float(np.sqrt(np.mean(self.noise.sigma**2) + np.mean(self.noise.common_sigma**2)))

    @property
    def frames_of_noise(self) -> np.ndarray:
        """(T,) what sigma is multiplied by in each frame."""
        return np.ones(len(self.position)) if self.course is None else self.course

    @property
    def denied(self) -> bool:
        """Whether the tracks show another sigma than was stated."""
        known = self.seen_sigma is not None and self.stated is not None
        return known and self.seen_sigma.differs(self.stated)

    def without(self, markers: np.ndarray) -> Observation:
        """The same measurement with (M,) bool markers left out."""
        return replace(self, weight=np.where(markers, 0.0, self.weight))


def observe(recording: Sequence, attachment: Attachment) -> Observation:
    """The markers of a sequence; noise from markers that cannot move, its scale as all tracks show it from
    frame to frame where they tell, else as stated.

    Markers cannot move before a release, or where they sit on what is held: there the hold's own motion
    is taken off, and what a late clock, a wrong scale or a drifting frame shows there: these are faults to be
    found, not noise. Raises ValueError for a sequence without markers.
    """
    markers = recording.markers
    if markers is None:
        raise ValueError(f"sequence '{recording.name}' has no markers")
    position = np.asarray(markers.position, float)
    if markers.spread is not None:
        noise, whole = _noise_of_tracks(markers), np.ones(position.shape[1])
        return Observation(position, noise, whole, sensors=sensor_observations(recording))
    rest, what = None, ""
    times = np.arange(recording.frames) / recording.fps
    if recording.release is not None and recording.release >= 20:
        # The last two frames may already move: the release is uncertain by that much.
        rest = position[: recording.release - 2]
        mean = mean_seen(rest, 0)
        rest = without_faults(rest - mean, times[: len(rest)], np.broadcast_to(mean, rest.shape))
        what = "markers before the release"
    else:
        held = attachment.hold >= 0
        if held.any():
            true = np.full_like(position[:, held], np.nan)
            index = np.flatnonzero(held)
            for h, hold in enumerate(recording.held):
                mine = attachment.hold[index] == h
                rotation, shift = hold.poses(times, recording.fps)
                at = (attachment.anchor + attachment.offset)[index[mine]]
                true[:, mine] = np.einsum("tij,mj->tmi", rotation, at) + shift[:, None]
            rest = without_faults(position[:, held] - true, times, true)
            what = "markers on what is held"
    stated = markers.stated or DEFAULT_SIGMA
    sigma = markers.sigma if markers.sigma else DEFAULT_SIGMA
    own = None if markers.scatter is None else markers.each / sigma
    if own is not None and rest is not None:
        rest = rest / (own if rest.shape[1] == len(own) else own[held])[:, None]
    still = rest is not None and int(np.isfinite(rest).all(2).sum(0).max(initial=0)) >= MINIMUM_REST_FRAMES
    # Where markers differ each has its own, which was read off the tracks as well.
    seen = None if own is not None else seen_sigma(position)
    # Noise that lasts is not seen in differences: without markers at rest, which show it, less than was
    # stated is no proof; nor is more, where the motion that markers share may be what differs.
    louder = seen is not None and seen.value > stated and seen.differs(stated)
    if seen is not None and not (own_noise(position) > ALIKE * seen.value if louder else still):
        seen = None
    before, sigma = sigma, sigma if seen is None else seen.value
    course = noise_course(position)
    if course is not None and rest is not None:
        rest = rest / course[: len(rest), None, None]
    if rest is None or rest.shape[1] == 0:
        noise = NoiseModel.white(sigma, "stated sigma, taken as white")
    else:
        noise = noise_from_rest(rest, sigma, what=what)
        if seen is not None and not louder and noise.correlation.order:
            # The rest shows noise that lasts: of that, differences from frame to frame see a part.
            seen, sigma = None, before
            noise = noise_from_rest(rest, sigma, what=what)
        if noise.sigma.ndim and rest.shape[1] != position.shape[1]:
            # Learnt on some markers: all others get the typical one.
            noise = NoiseModel(
                sigma=np.asarray(np.median(noise.sigma)),
                source=noise.source,
                correlated_share=np.asarray(np.median(noise.correlated_share)),
                correlation=noise.correlation,
                common_sigma=noise.common_sigma,
                common_correlation=noise.common_correlation,
                scale_degrees=noise.scale_degrees,
            )
    if seen is not None:
        source = noise.source.replace("stated", "seen from frame to frame")
        noise = replace(noise, source=source, scale_degrees=min(noise.scale_degrees, seen.degrees))
    if own is not None:
        source = f"{noise.source}; each marker's own share as the tracks show"
        noise = replace(noise, sigma=noise.sigma * own, source=source)
    if markers.offset:
        noise = _with_offset(noise, markers.offset)
    if course is not None:
        low, high = 1e3 * sigma * course.min(), 1e3 * sigma * course.max()
        changes = f"not the same in all frames: {low:.2g} to {high:.2g} mm, each is weighed by its own"
        noise = replace(noise, source=f"{noise.source}; {changes}")
    return Observation(
        position, noise, np.ones(position.shape[1]), stated, seen, sensor_observations(recording), course
    )


def noise_document(observations: Mapping[str, Observation]) -> dict[str, dict[str, object]]:
    """By sequence: the standard deviation of a coordinate as stated, as seen in the tracks (None where they
    do not tell), and as used [m], and where that comes from; lowest and highest: of any frame [m]."""
    return {
        name: {
            "stated": observation.stated,
            "seen": None if observation.seen_sigma is None else observation.seen_sigma.value,
            "used": observation.sigma,
            "differs": observation.denied,
            "lowest": observation.sigma * float(observation.frames_of_noise.min()),
            "highest": observation.sigma * float(observation.frames_of_noise.max()),
            "source": observation.noise.source,
        }
        for name, observation in observations.items()
    }


def noise_lines(document: Mapping[str, Mapping[str, object]]) -> list[str]:
    """A line for each sequence whose noise is another than was stated, or changes over the frames."""
    lines = [
        f"{name}: sigma is stated as {1e3 * entry['stated']:.3g} mm, but the tracks show "
        f"{1e3 * entry['seen']:.3g} mm from frame to frame, which is used"
        for name, entry in document.items()
        if entry["differs"]
    ]
    return lines + [
        f"{name}: the noise changes over the frames, {1e3 * entry['lowest']:.2g} to "
        f"{1e3 * entry['highest']:.2g} mm; each frame is weighed by its own"
        for name, entry in document.items()
        if entry.get("lowest", 0.0) < entry.get("highest", 0.0)
    ]


def _with_offset(noise: NoiseModel, offset: float) -> NoiseModel:
    """The noise with a constant error of each marker's place [m] beside it, as one that all but stays."""
    variance = noise.sigma**2 + offset**2
    lasts = noise.correlation if noise.correlated_share.any() else Autoregression((STAYS,))
    share = (noise.correlated_share * noise.sigma**2 + offset**2) / variance
    source = f"{noise.source}; places of the markers known to {1e3 * offset:.2g} mm"
    return replace(
        noise, sigma=np.sqrt(variance), correlated_share=share, correlation=lasts, source=source
    )


def without_faults(rest: np.ndarray, times: np.ndarray, position: np.ndarray) -> np.ndarray:
    """What is left of the residual of markers that cannot move when faults of the measurement are taken off.

    rest: (T, M, 3) [m], NaN where missing; times: (T,) [s]; position: (T, M, 3) [m], where they truly are,
    NaN where that is missing. The time offset, the length scale and the frame's drift (its velocity and its
    turning) that fit it best are taken off together, by least squares; what is left is scaled up by what this
    takes of the noise.
    """
    axes = np.eye(3)
    t = times[:, None, None]
    at = np.nan_to_num(position)
    columns = [at] + [np.broadcast_to(t * axis, at.shape) for axis in axes]
    columns += [t * np.cross(axis, at) for axis in axes]
    if len(times) > 2:
        # A clock that is late by tau shows tau v + tau^2 a / 2.
        speed = np.gradient(at, times, axis=0, edge_order=2)
        columns += [speed, np.gradient(speed, times, axis=0, edge_order=2)]
    seen = np.isfinite(rest) & np.isfinite(position)
    matrix = np.stack([column[seen] for column in columns], axis=1)
    scale = np.linalg.norm(matrix, axis=0)
    matrix = matrix[:, scale > 0] / scale[scale > 0]
    rows, numbers = matrix.shape
    if rows <= 4 * numbers:
        return rest
    shares = np.linalg.lstsq(matrix, rest[seen], rcond=1e-6)[0]
    left = rest.copy()
    left[seen] -= matrix @ shares
    return left * np.sqrt(rows / (rows - numbers))


def _noise_of_tracks(markers: Markers) -> NoiseModel:
    """Noise of tracks from video as their stage states it: they drift, each with a scale of its own."""
    lasting = markers.lasting if markers.memory > 0.0 else 0.0
    none = np.asarray(0.0)
    return NoiseModel(
        sigma=np.asarray(markers.spread, float),
        source=f"tracks from video: as stated, {lasting:.2f} of it lasts by {markers.memory:.2f} a frame",
        correlated_share=np.asarray(lasting),
        correlation=Autoregression((markers.memory,) if markers.memory > 0.0 else ()),
        common_sigma=none,
        common_correlation=Autoregression(),
    )
