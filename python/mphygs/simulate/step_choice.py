"""How many implicit steps a frame takes: as many as the measured motion needs beside its noise."""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil

import numpy as np

from mphygs.capture.record import Sequence as Recording

# What implicit steps have at least, on a grid of default spacing or a coarser one. A swing of a sixth of the
# frame rate falls behind by 0.14 % of its period then, or half of it in pairs, each of which is one step of
# its rule (Bathe and Baig 2005). Newton's method does not always find a step of half a frame.
FEWEST = 8
FEWEST_PAIRED = 2 * FEWEST
# Of the noise, that the steps may be off: together they are 3 % more than the noise.
SHARE = 0.25
# Of a frequency's power over that of the noise, from which on it is taken as motion.
SEEN = 9.0


def steps_a_frame(recording: Recording, *, paired: bool = False, finer: float = 1.0) -> int:
    """The fewest steps a frame, not below the least, whose error is below SHARE of the markers' noise.

    The midpoint rule swings by (w h)^2 / 12 too slowly, in pairs with BDF2 by 0.162 (w h)^2: the first terms
    of log A - i w h, A by what a step multiplies e^(i w t). After t a swing of the frequency w is off by w t
    times that share of its size, at most counted as all of it. What swings is taken from the spectrum of the
    markers in the frames to fit, so that the steps are the same whatever a fit tries, now and when it goes
    on. A motion that is no swing, as the fall of a sheet by its own length, may be off by some times that. So
    steps go with the grid where it is finer than the default one: what changes on such a grid tells the error
    of both, which fall alike.

    paired: whether the steps are; finer: default spacing over that of the grid.
    """
    finer = max(finer, 1.0)
    least = ceil((FEWEST_PAIRED if paired else FEWEST) * finer - 1e-9)
    first = recording.release or 0
    swings = None if recording.markers is None else _spectrum(recording, max(first, recording.fit[0]))
    if swings is None:
        return least
    rate, power, noise = swings
    span = (recording.frames - first) / recording.fps
    delay = 2.0 * np.sqrt(2.0) - 8.0 / 3.0 if paired else 1.0 / 12.0
    steps = FEWEST
    while True:
        late = delay * rate**3 * span / (np.sqrt(3.0) * (steps * recording.fps) ** 2)
        if (np.minimum(late, 1.0) ** 2) @ power <= (SHARE * noise) ** 2:
            return max(least, ceil(steps * finer - 1e-9))
        steps += 1


def steps_to_predict(
    recording: Recording, others: Iterable[Recording], *, paired: bool = False, finer: float = 1.0
) -> int:
    """As `steps_a_frame`; where nothing is fitted, steps as short as any of the other sequences takes."""
    steps = [steps_a_frame(recording, paired=paired, finer=finer)]
    if recording.fit[1] <= recording.fit[0]:
        rates = [steps_a_frame(other, paired=paired, finer=finer) * other.fps for other in others]
        steps += [ceil(rate / recording.fps - 1e-9) for rate in rates]
    return max(steps)


def _spectrum(recording: Recording, first: int) -> tuple[np.ndarray, np.ndarray, float] | None:
    """Frequencies [rad/s], mean square of a coordinate of the motion at each [m^2], and the noise [m]; None
    where no marker is seen in all frames, or in too few for a window."""
    markers = recording.markers
    assert markers is not None
    seen = markers.position[first : recording.fit[1]]
    whole = np.isfinite(seen).all((0, 2)) if len(seen) else np.zeros(0, bool)
    if len(seen) < FEWEST or not whole.any():
        return None
    track = seen[:, whole].reshape(len(seen), -1)
    time = np.linspace(-1.0, 1.0, len(track))
    line = np.stack([np.ones_like(time), time], axis=1)
    window = np.blackman(len(track) + 2)[1:-1]  # its ends join: a jump there would count as swift
    swing = window[:, None] * (track - line @ np.linalg.lstsq(line, track, rcond=None)[0])
    power = (np.abs(np.fft.rfft(swing, axis=0)) ** 2).mean(1) / (window @ window)
    noise = float(np.sqrt((markers.each[whole] ** 2).mean()))
    rate = 2.0 * np.pi * recording.fps * np.fft.rfftfreq(len(track))
    both = np.where((rate > 0.0) & (rate < 0.999 * np.pi * recording.fps), 2.0, 1.0)  # signs of the frequency
    power = np.where(power > SEEN * noise**2, both * (power - noise**2), 0.0) / len(track)
    return rate, power, noise
