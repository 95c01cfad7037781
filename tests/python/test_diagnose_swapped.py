"""Markers whose labels were exchanged midway: a fault of the measurement, put right and named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bar_capture import bar_belief, bar_capture
from command_example import answer
from extend_example import SIGMA, recorded
from mphygs.capture.record import Known
from mphygs.capture.save import save_capture
from mphygs.commands import diagnose, fit

FRAMES = 30


def test_two_labels_that_are_exchanged_midway_are_named(tmp_path: Path) -> None:
    shake = 0.006 * np.sin(np.linspace(0.0, 12.0, FRAMES))[:, None] * [0.2, 1.0, 0.4]
    random = np.random.default_rng(3)
    at = random.uniform(0.2, 1.0, (14, 3)) * [0.06, 0.02, 0.02]
    capture = bar_capture(
        frames=FRAMES, fps=60.0, motion=shake, fit=(0, FRAMES), sigma=SIGMA, markers_at=at,
        known=Known(density={"part0": 1000.0}),
    )  # fmt: skip
    made = recorded(capture, bar_belief(capture, youngs_modulus=5e4))
    recording = made.sequence("a")
    position = recording.markers.position.copy()
    position[12:, [2, 9]] = position[12:, [9, 2]]
    swapped = replace(recording, markers=replace(recording.markers, position=position))
    save_capture(replace(made, sequences=(swapped,)), tmp_path / "capture")
    run = tmp_path / "run"
    answer(fit.main, tmp_path / "capture", "--out", run, "--spacing", "0.01")
    found = answer(diagnose.main, run, "--effects", "viscosity,marker_outliers")
    assert (found["verdict"], found["effects"]) == ("measurement", ["label_swaps"])
