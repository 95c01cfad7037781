"""What an error of clock, lengths, thickness and gravity does to a fit, beside fits with that error."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bar_capture import bar_belief, bar_capture
from extend_example import SIGMA, recorded
from mphygs.capture.format import Capture
from mphygs.capture.record import Known
from mphygs.fit.experiment import Experiment
from mphygs.fit.levenberg_marquardt import minimise
from mphygs.fit.problem import Problem
from mphygs.fit.sensitivity import WHY, sensitivity_lines, sensitivity_of
from mphygs.model.belief import Belief
from mphygs.simulate.settings import Settings

FREE, FRAMES, KEY = ("part0.youngs_modulus",), 30, "part0.youngs_modulus"
SHAKE = 0.006 * np.sin(np.linspace(0.0, 9.0, FRAMES))[:, None] * [0.2, 1.0, 0.4]


def made(capture: Capture, belief: Belief) -> tuple[Problem, Belief]:
    """The fit of a capture, and what it led to."""
    problem = Experiment.of(capture, Settings(0.01, workers=1)).problem(0.01)
    return problem, minimise(problem, belief, tolerance=1e-3, relative_tolerance=1e-6).belief


@pytest.fixture(scope="module")
def bar() -> tuple[Capture, Belief]:
    known = Known(density={"part0": 1000.0})
    capture = bar_capture(
        frames=FRAMES, fps=60.0, motion=SHAKE, fit=(0, FRAMES), sigma=SIGMA, known=known
    )
    belief = bar_belief(capture, youngs_modulus=5e4, free=FREE)
    return recorded(capture, belief), belief


def test_refits_with_the_error_in_them_move_as_the_table_says(bar: tuple[Capture, Belief]) -> None:
    capture, belief = bar
    problem, found = made(capture, belief)
    told = sensitivity_of(problem, found, problem.evaluate(found))
    assert set(told) == {"clock", "lengths", "thickness", "gravity"}
    faster = replace(capture, sequences=tuple(replace(s, fps=1.01 * s.fps) for s in capture.sequences))
    moved = made(faster, belief)[1][KEY].value - found[KEY].value
    assert abs(moved) > 0.003 * found[KEY].value
    assert told["clock"]["parameters"][KEY] == pytest.approx(moved, rel=0.15)
    down = np.linalg.norm(capture.gravity)
    angle = np.radians(1.0)
    squares = 0.0
    for side in np.delete(np.eye(3), np.argmax(np.abs(capture.gravity)), axis=0):
        tilted = np.cos(angle) * np.asarray(capture.gravity) + np.sin(angle) * down * side
        other = replace(belief, gravity=tilted)
        squares += (made(replace(capture, gravity=tilted), other)[1][KEY].value - found[KEY].value) ** 2
    assert told["gravity"]["parameters"][KEY] == pytest.approx(np.sqrt(squares), rel=0.25)


def test_the_table_tells_moduli_in_per_cent() -> None:
    found = {"clock": {"change": "1 %", "parameters": {KEY: 1000.0, "a.release_shift": -1e-4}}}
    told = {KEY: {"value": 5e4, "unit": "Pa"}, "a.release_shift": {"value": 0.0, "unit": "s"}}
    rows = sensitivity_lines(found, told)
    assert rows[1] == ["1 % of clock", "+2 %", "-0.0001 s"] and rows[0][1:] == list(told)
    assert "geometry and the clock" in WHY
