"""How many implicit steps a frame has: by the measured motion and its noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from mphygs.capture.format import Capture, Known, Markers
from mphygs.scene.spacing_worth import usual_spacing
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.settings import IMPLICIT, Settings
from mphygs.simulate.step_choice import FEWEST, FEWEST_PAIRED, SHARE, steps_a_frame, steps_to_predict

FPS, FRAMES = 60.0, 120


def beam(frames: int = FRAMES, motion: np.ndarray | None = None) -> Capture:
    return bar_capture(
        lengths=(0.2,), side=0.016, held=0.016, frames=frames, fps=FPS, motion=motion,
        known=Known(density={"part0": 800.0}, poissons_ratio=0.3), fit=(0, frames), gravity=np.zeros(3),
    )  # fmt: skip


def measured(capture: Capture, motion: np.ndarray, sigma: float, seed: int = 1) -> Capture:
    """With markers that move by (T,) [m] or are at (T, M, 3) [m], and noise."""
    one = capture.sequences[0]
    assert one.markers is not None
    at = one.markers.at
    there = at + motion[:, None, None] * np.ones_like(at) if motion.ndim == 1 else motion
    noise = sigma * np.random.default_rng(seed).standard_normal(there.shape)
    markers = Markers(there + noise, at, sigma)
    return replace(capture, sequences=(replace(one, markers=markers),))


@pytest.mark.parametrize(
    ("hertz", "size", "sigma"), [(3.0, 0.02, 1e-5), (6.0, 0.01, 1e-4), (10.0, 0.002, 1e-5)]
)
def test_a_swing_gets_the_steps_that_its_delay_asks_for(hertz: float, size: float, sigma: float) -> None:
    rate = 2 * np.pi * hertz
    capture = measured(beam(), size * np.sin(rate * np.arange(FRAMES) / FPS), sigma)
    delayed = rate**3 * (FRAMES / FPS) / (12 * np.sqrt(3)) * size / np.sqrt(2)  # times h^2, rms over the time
    expected = np.sqrt(delayed / (SHARE * sigma)) / FPS
    assert expected > 1.2 * FEWEST
    assert steps_a_frame(capture.sequences[0]) == pytest.approx(expected, rel=0.15)
    paired = steps_a_frame(capture.sequences[0], paired=True)
    assert paired == pytest.approx(max(expected * 1.94**0.5, FEWEST_PAIRED), rel=0.15)


@pytest.mark.parametrize(("paired", "share"), [(False, 1 / 12), (True, 2 * 2**0.5 - 8 / 3)])
def test_a_step_delays_a_swing_by_the_share_that_is_counted(paired: bool, share: float) -> None:
    z = 0.05j  # i w h
    span = 2 - 2**0.5 if paired else 0.5
    middle = (1 + span * z) / (1 - span * z)
    after = ((1 + 2**0.5) * middle + 1 - 2**0.5) / 2 / (1 - span * z)
    steps, factor = (2, after) if paired else (1, middle)
    assert 1 - np.angle(factor) / (steps * z.imag) == pytest.approx(share * z.imag**2, rel=0.01)


def test_noise_and_rest_ask_for_no_more_steps_than_the_fewest() -> None:
    capture = beam()
    still = np.zeros(FRAMES)
    for sigma in (1e-6, 1e-3):
        assert steps_a_frame(measured(capture, still, sigma).sequences[0]) == FEWEST
    assert steps_a_frame(replace(capture.sequences[0], markers=None)) == FEWEST


def test_a_motion_that_is_not_fitted_has_steps_as_short_as_those_that_are() -> None:
    swing = 0.02 * np.sin(2 * np.pi * 6.0 * np.arange(FRAMES) / FPS)
    swift, slow = (measured(beam(), s, 1e-5).sequences[0] for s in (swing, 0.01 * swing))
    other = replace(slow, name="b", fps=2 * FPS, fit=(0, 0), predict=(0, FRAMES))
    assert steps_to_predict(swift, (swift, other)) == steps_a_frame(swift)
    assert steps_to_predict(slow, (swift, slow)) == steps_a_frame(slow) < steps_a_frame(swift)
    assert 2 * steps_to_predict(other, (swift, other)) in (steps_a_frame(swift), steps_a_frame(swift) + 1)


def test_steps_are_as_much_shorter_as_cells_are() -> None:
    still, swing = np.zeros(FRAMES), 0.02 * np.sin(2 * np.pi * 6.0 * np.arange(FRAMES) / FPS)
    calm, swift = (measured(beam(), motion, 1e-5).sequences[0] for motion in (still, swing))
    for paired, fewest in ((False, FEWEST), (True, FEWEST_PAIRED)):
        assert steps_a_frame(calm, paired=paired, finer=1.5) == 1.5 * fewest
        assert steps_a_frame(calm, paired=paired, finer=0.75) == fewest
        asked = steps_a_frame(swift, paired=paired)
        assert steps_a_frame(swift, paired=paired, finer=1.5) == pytest.approx(1.5 * asked, abs=1)
        assert steps_a_frame(swift, paired=paired, finer=0.75) == asked > fewest


def test_runs_on_a_finer_grid_than_the_default_take_shorter_steps() -> None:
    capture = beam(frames=3)
    usual, belief = usual_spacing(capture.parts), bar_belief(capture, youngs_modulus=3e6, density=800.0)
    steps = []
    for share in (1.5, 1.0, 0.5):
        settings = Settings(share * usual, workers=1, integrator=IMPLICIT)
        predictor = Predictor(capture, capture.sequence("a"), settings)
        timeline = predictor.timeline(belief, 3, predictor.stable_substep(belief))
        steps.append(timeline.schedule["steps"].tolist())
    assert steps == [2 * [FEWEST], 2 * [FEWEST], 2 * [2 * FEWEST]]


def test_frames_that_are_not_fitted_are_not_looked_at() -> None:
    swing = 0.02 * np.sin(2 * np.pi * 6.0 * np.arange(FRAMES) / FPS)
    capture = measured(beam(), np.where(np.arange(FRAMES) < 60, 0.0, swing), 1e-5)
    one = capture.sequences[0]
    assert steps_a_frame(one) > FEWEST
    assert steps_a_frame(replace(one, fit=(0, 60), predict=(60, FRAMES))) == FEWEST


def test_the_steps_that_are_chosen_keep_the_error_below_the_noise() -> None:
    frames, sigma = 60, 2e-5
    times = np.arange(frames) / FPS
    motion = np.zeros((frames, 3))
    motion[:, 1] = 0.01 * (1 - np.cos(2 * np.pi * 4.0 * times))
    capture = beam(frames, motion)
    belief = bar_belief(capture, youngs_modulus=3e6, density=800.0)
    settings = Settings(0.016, workers=1, integrator=IMPLICIT)

    def moved(steps: int) -> np.ndarray:
        predictor = Predictor(capture, capture.sequence("a"), settings)
        predictor.steps_a_frame = steps
        return predictor.predict(belief).position

    chosen = steps_a_frame(measured(capture, moved(64), sigma).sequences[0])
    assert chosen > FEWEST
    off = [np.sqrt(np.mean((moved(steps) - moved(4 * chosen)) ** 2)) for steps in (FEWEST, chosen)]
    assert off[1] < SHARE * sigma < off[0]
