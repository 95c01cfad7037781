"""A tiny capture made with the package's own simulator, for the tests of the commands."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import trimesh

from mphygs.capture.format import Capture, Hold, Known, Markers, Part, Sequence, save_capture
from mphygs.fit.start import starting_belief
from mphygs.simulate.prediction import Predictor, Settings

SPACING = 0.006
FRAMES = 24
TRUTH = {"bar.youngs_modulus": 2.5e5}
ETA = 60.0
SIGMA = 1e-4


def bar_part() -> Part:
    """A bar of 54 x 12 x 12 mm."""
    box = trimesh.creation.box(bounds=np.array([[0, 0, 0], [0.054, 0.012, 0.012]]))
    return Part("bar", np.array(box.vertices), np.array(box.faces))


def make_capture(
    folder: Path, *, known: Known | None = None, eta: float = ETA, release: int | None = None
) -> Path:
    """A clamped bar that falls and swings: `swing` to fit and predict, `other`, shaken, to predict only."""
    if known is None:
        capture = usual_capture(eta, release)
    else:
        capture = measured(unmeasured(known, release), eta)
    save_capture(replace(capture, folder=folder), folder)
    return folder


@cache
def usual_capture(eta: float, release: int | None) -> Capture:
    """Of known density and Poisson's ratio. Many tests begin with it."""
    return measured(unmeasured(Known(density={"bar": 1000.0}, poissons_ratio=0.4), release), eta)


def unmeasured(known: Known, release: int | None) -> Capture:
    """Without measurements."""
    grid = np.array([[x, y, z] for x in (0.0, 0.03, 0.054) for y in (0.0, 0.012) for z in (0.0, 0.012)])
    hold = Hold(box=np.array([[-1.0, -1, -1], [1e-4, 1, 1]]))
    swing = Sequence(
        "swing", 100.0, FRAMES, (release or 0, 16), (16, FRAMES), (hold,), release=release,
        markers=Markers(np.zeros((FRAMES, len(grid), 3)), grid, SIGMA),
    )  # fmt: skip
    times = np.arange(FRAMES) / 100.0
    position = np.zeros((FRAMES, 3))
    position[:, 1] = 0.004 * np.sin(12.0 * times) ** 2
    moving = Hold(hold.box, position, np.tile([1.0, 0, 0, 0], (FRAMES, 1)))
    other = replace(swing, name="other", fit=(0, 0), predict=(release or 0, FRAMES), held=(moving,))
    return Capture(
        "tiny", Path("tiny"), np.array([0.0, 0, -9.81]), (bar_part(),), "stress-free", known, (swing, other)
    )


def measured(capture: Capture, eta: float) -> Capture:
    """The capture with markers simulated at the truth, noise added."""
    belief = starting_belief(capture)
    for key, value in TRUTH.items():
        belief = belief.with_parameter(key, value=value)
    belief = belief.with_parameter("bar.density", value=1000.0)
    if eta:
        belief = belief.with_effect("viscosity", {"eta": eta})
    noise = np.random.default_rng(1)
    recordings = []
    for recording in capture.sequences:
        position = Predictor(capture, recording, Settings(SPACING, workers=1)).predict(belief).position
        position = position + SIGMA * noise.standard_normal(position.shape)
        position[5, 3] = np.nan
        recordings.append(replace(recording, markers=replace(recording.markers, position=position)))
    return replace(capture, sequences=tuple(recordings))


def call(main: Callable[[list[str]], int], *arguments: object) -> tuple[int, str, str]:
    """Exit code, standard output and standard error of a command run in this process."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main([str(argument) for argument in arguments])
    return code, out.getvalue(), err.getvalue()


def answer(main: Callable[[list[str]], int], *arguments: object) -> dict:
    """The JSON of a command that has to succeed."""
    code, out, err = call(main, *arguments, "--json")
    assert code == 0, err
    assert out.count("\n") == 1, "exactly one line of JSON on standard output"
    return json.loads(out)
