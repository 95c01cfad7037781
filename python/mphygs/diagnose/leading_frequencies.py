"""Frequencies at which a course in time swings most."""

from __future__ import annotations

import numpy as np


def swing_frequencies(course: np.ndarray, fps: float, count: int) -> list[float]:
    """Frequencies [Hz] of the `count` largest peaks of power, strongest first; fewer where there are no more.

    course: (T, C), finite, `fps` values of each channel per second; its mean is taken away and its ends are
    tapered (Hann). Less than one and a half periods in the course are none, nor is what is 2.5 steps of the
    spectrum or less from a stronger peak.
    """
    centred = course - course.mean(0)
    power = (np.abs(np.fft.rfft(centred * np.hanning(len(course))[:, None], axis=0)) ** 2).sum(1)
    frequency = np.fft.rfftfreq(len(course), 1.0 / fps)
    step = fps / len(course)
    power[frequency < 1.5 * step] = 0.0
    found: list[float] = []
    for k in np.argsort(-power):
        if len(found) == count or power[k] == 0.0:
            break
        if all(abs(frequency[k] - f) > 2.5 * step for f in found):
            found.append(float(frequency[k]))
    return found
