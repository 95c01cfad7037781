"""A bar of two parts shaken by its hold, for the tests of the missing force."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bar_capture import bar_belief, bar_capture
from mphygs.capture.format import Capture
from mphygs.compare.noise import observe
from mphygs.fit.problem import Problem
from mphygs.model.belief import Belief
from mphygs.simulate.prediction import Settings

SPACING, SIGMA, FRAMES, FPS = 0.015, 5e-5, 30, 50.0
LENGTHS, SIDE = (0.045, 0.03), 0.015


def shaken_bar(frames: int = FRAMES, *, markers: int = 40) -> Capture:
    """Nothing measured yet: the markers stand where they are at rest."""
    random = np.random.default_rng(5)
    at = random.uniform(size=(markers, 3)) * [sum(LENGTHS), SIDE, SIDE]
    times = np.arange(frames) / FPS
    motion = np.zeros((frames, 3))
    motion[:, 1] = 0.012 * np.minimum(times / 0.4, 1.0) * np.sin(2 * np.pi * 3.0 * times)
    return bar_capture(
        lengths=LENGTHS, side=SIDE, frames=frames, fps=FPS, markers_at=at, sigma=SIGMA, motion=motion,
        fit=(0, frames),
    )  # fmt: skip


def soft_belief(capture: Capture, *, free: tuple[str, ...] = ("part0.youngs_modulus",)) -> Belief:
    """The materials of the bar."""
    return bar_belief(capture, youngs_modulus=6e4, density=500.0, free=free)


def measured_problem(capture: Capture, position: np.ndarray, *, dtype: str = "float32") -> Problem:
    """The fit to markers seen at `position` (T, M, 3) [m], with noise."""
    noise = SIGMA * np.random.default_rng(7).standard_normal(position.shape)
    recording = capture.sequences[0]
    recording = replace(recording, markers=replace(recording.markers, position=position + noise))
    capture = replace(capture, sequences=(recording,))
    settings = Settings(SPACING, workers=1, dtype=dtype)
    problem = Problem(capture, settings, {"a": (0, recording.frames)}, {})
    seen = observe(recording, problem.predictors["a"].attachment)
    return Problem(capture, settings, problem.ranges, {"a": seen}, problem.predictors)
