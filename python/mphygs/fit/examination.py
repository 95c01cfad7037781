"""What a recording shows before anything is fitted: rates, gaps, noise, what rests, how the motion begins."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from mphygs.capture.format import Capture
from mphygs.capture.record import Sequence as Recording
from mphygs.compare.masked_means import mean_seen
from mphygs.compare.noise import Observation, observe
from mphygs.fit.first_frames import first_state
from mphygs.simulate.body import Attachment

# A swing is followed from so many frames a period on, and its decay from so many periods on.
FRAMES_A_PERIOD, PERIODS = 5.0, 2.0
# A stated sigma is doubted where the noise that is seen is so many times as large, or as small.
TOO_SMALL, TOO_LARGE = 1.4, 3.0
# Share of the measurements that may be missing, and of a sequence that one gap may be, before it is said.
MISSING, GAP = 0.1, 0.1
# Farthest that a marker is from its mean place, over the noise, below which a sequence tells next to nothing.
STILL = 10.0


@dataclass(frozen=True)
class Examined:
    """One sequence. seconds: its length; missing: share of the measurements; longest_gap [frames];
    sigma_stated and sigma_seen [m], seen_by: where the latter was read off (None where nothing shows it);
    at_rest: markers on what is held; rest_frames: before the release; moves: farthest that a marker is from
    its mean place, over sigma; frequency: at which it moves most [Hz]; begins: "rest" or "measured"."""

    fps: float
    frames: int
    seconds: float
    markers: int
    missing: float
    longest_gap: int
    sigma_stated: float
    sigma_seen: float | None
    seen_by: str | None
    at_rest: int
    rest_frames: int
    moves: float
    frequency: float
    begins: str

    def document(self) -> dict[str, object]:
        """The same as JSON."""
        return asdict(self)


def examine(capture: Capture, recording: Recording, attachment: Attachment) -> Examined:
    """What the markers of a sequence show. Raises ValueError for a sequence without markers."""
    markers = recording.markers
    if markers is None:
        raise ValueError(f"sequence '{recording.name}' has no markers")
    position = np.asarray(markers.position, float)
    seen = np.isfinite(position).all(2)
    observation = observe(recording, attachment)
    sigma, by = _noise_seen(observation)
    stated = observation.stated or markers.sigma
    free = attachment.hold < 0
    moved = np.abs(position[:, free] - mean_seen(position[:, free], 0))
    moves = float(np.nanmax(moved)) if np.isfinite(moved).any() else 0.0
    state = None if recording.release is not None else first_state(capture, recording)
    begins = "rest" if state is None or state.at_rest or recording.start == "rest" else "measured"
    return Examined(
        fps=recording.fps,
        frames=recording.frames,
        seconds=recording.frames / recording.fps,
        markers=position.shape[1],
        missing=float(1.0 - seen.mean()),
        longest_gap=longest_gap(seen),
        sigma_stated=stated,
        sigma_seen=sigma,
        seen_by=by,
        at_rest=int((~free).sum()),
        rest_frames=recording.release or 0,
        moves=moves / (sigma or stated),
        frequency=track_frequency(position[:, free], recording.fps),
        begins="measured" if recording.start == "measured" else begins,
    )


def _noise_seen(observation: Observation) -> tuple[float | None, str | None]:
    """Noise of a coordinate [m] as all tracks show it, else as points that cannot move do."""
    if observation.seen_sigma is not None:
        return observation.seen_sigma.value, "as the tracks show from frame to frame"
    if observation.noise.source.startswith("stated"):
        return None, None
    return observation.sigma, observation.noise.source


def longest_gap(measured: np.ndarray) -> int:
    """Most frames in a row in which a marker is not seen, between two in which it is. measured: (T, M)."""
    longest = 0
    for column in measured.T:
        frames = np.flatnonzero(column)
        longest = max(longest, int(np.diff(frames).max(initial=1)) - 1)
    return longest


def track_frequency(position: np.ndarray, fps: float) -> float:
    """Frequency [Hz] at which the velocity of tracks (T, M, 3) is largest: a place that is left for another
    one, as by sagging, is no swing. Gaps are bridged by straight lines; 0 for less than four frames."""
    frames = np.arange(len(position))
    columns = position.reshape(len(position), -1).T
    tracks = [np.interp(frames, frames[ok], c[ok]) for c in columns if (ok := np.isfinite(c)).any()]
    if len(frames) < 4 or not tracks:
        return 0.0
    velocity = np.diff(np.stack(tracks, axis=1), axis=0)
    power = (np.abs(np.fft.rfft(velocity * np.hanning(len(velocity))[:, None], axis=0)) ** 2).sum(1)
    return float(np.fft.rfftfreq(len(velocity), 1.0 / fps)[1:][power[1:].argmax()])


def remarks(name: str, found: Examined) -> list[str]:
    """What of a sequence is worth a line, with what to do about it."""
    lines = []
    period = found.fps / found.frequency if found.frequency else np.inf
    if period < FRAMES_A_PERIOD:
        lines.append(
            f"it moves most at {found.frequency:.3g} Hz, {period:.2g} frames a period; "
            f"record at {FRAMES_A_PERIOD * found.frequency:.3g} frames per second or more"
        )
    if found.seconds * found.frequency < PERIODS:
        lines.append(
            f"it lasts {found.seconds:.3g} s, no more than {found.seconds * found.frequency:.2g} periods of "
            "its main motion: damping is hardly seen; record longer, or excite a faster motion"
        )
    if found.missing > MISSING:
        lines.append(f"{100 * found.missing:.0f} % of the marker positions are missing")
    if found.longest_gap > GAP * found.frames:
        lines.append(f"a marker is unseen for {found.longest_gap} frames in a row")
    if found.sigma_seen is not None:
        ratio = found.sigma_seen / found.sigma_stated
        seen, stated = 1e3 * found.sigma_seen, 1e3 * found.sigma_stated
        if ratio > TOO_SMALL or ratio < 1.0 / TOO_LARGE:
            lines.append(
                f"the noise is {seen:.2g} mm a coordinate ({found.seen_by}), sigma is {stated:.2g} mm; "
                f"state {found.sigma_seen:.2g}, or look for what makes the difference"
            )
    if found.moves < STILL:
        lines.append(
            f"no marker moves by more than {found.moves:.2g} sigma: this tells next to nothing; move it more"
        )
    if found.sigma_seen is None:
        lines.append(
            "nothing shows the noise by itself: no marker sits on what is held, no 20 frames are at rest, "
            "and the motion is too fast; put a marker on the holder, or record the object at rest first"
        )
    if found.begins == "measured":
        lines.append(
            "it does not begin at rest: its start is fitted with the rest, which costs certainty; "
            "record a second of rest before it moves"
        )
    return [f"{name}: {line}" for line in lines]
