"""Bars driven by a tendon or a pressure: what `synth` makes, and that a fit finds its numbers."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from command_example import answer, call
from mphygs.capture.actuators import Pressure, Tendon
from mphygs.capture.format import load_capture
from mphygs.commands.fit import main as fit
from mphygs.commands.synth import main as synth
from mphygs.synth.drive import Drive

QUICK = ["--frames", "24", "--markers", "16", "--spacing-share", "1.6", "--sigma", "1e-4"]


@pytest.mark.parametrize("simulator", ["total-lagrangian", "finite-element"])
def test_a_driven_bar_states_what_was_sent_and_answers_what_arrived(simulator: str, tmp_path: Path) -> None:
    done = answer(synth, "bar", "--drive", "tendon:gain=0.6:delay=0.03", "--simulator", simulator,
                  "--out", tmp_path / "made", *QUICK)  # fmt: skip
    capture = load_capture(done["capture"])
    truth = json.loads((tmp_path / "made" / "answer.json").read_text())
    assert truth["drives"] == [{"kind": "tendon", "gain": 0.6, "delay": 0.03}] * 2
    for sequence in capture.sequences:
        (tendon,) = sequence.actuators
        assert isinstance(tendon, Tendon) and tendon.unknown == ("gain", "delay")
        assert sequence.held[0].is_fixed and not tendon.values[: sequence.release + 1].any()
        tip = np.argmax(sequence.markers.at[:, 0])
        moved = np.nan_to_num(sequence.markers.position[:, tip] - sequence.markers.at[tip])
        # It bends towards the tendon's side.
        assert moved[-6:, 2].max() > 0.002


def test_the_two_simulators_agree_on_a_pressure(tmp_path: Path) -> None:
    tracks = []
    for simulator in ("total-lagrangian", "finite-element"):
        out = tmp_path / simulator
        clean = [*QUICK[:-2], "--sigma", "1e-9", "--dropout", "0"]
        answer(synth, "bar", "--drive", "pressure", "--simulator", simulator, "--out", out, *clean)
        sequence = load_capture(out).sequences[0]
        assert isinstance(sequence.actuators[0], Pressure) and sequence.actuators[0].unknown == ()
        tracks.append(sequence.markers.position)
    moved = np.linalg.norm(tracks[1] - tracks[1][0])
    assert np.abs(tracks[1] - tracks[1][0]).max() > 0.005
    # On grids of two cells to the section.
    assert np.linalg.norm(tracks[0] - tracks[1]) < 0.08 * moved


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["bar", "--drive", "rope"], "drive 'rope': expected one of tendon, pressure"),
        (["bar", "--drive", "tendon:gain=much"], "'gain=much' is no number"),
        (["bar", "--drive", "tendon:loss=0.1"], "unknown 'loss'; expected gain or delay"),
        (["bar", "--drive", "tendon:gain=0"], "expected a gain above 0"),
        (["block-flower", "--drive", "tendon"], "not of the object 'block-flower'; expected one of bar"),
        (["bar", "--drive", "tendon", "--start", "pulled"], "the hold stands still"),
    ],
)
def test_bad_drives(options: list[str], said: str, tmp_path: Path) -> None:
    code, _, err = call(synth, *options, "--out", tmp_path / "made", *QUICK)
    assert code == 2 and said in err and err.strip().count("\n") == 0


def test_a_drive_is_what_it_says() -> None:
    assert Drive.parse("pressure") == Drive("pressure", 1.0, 0.0)
    assert Drive.parse("tendon:delay=0.01").unknown == ("delay",)


@pytest.mark.slow
def test_a_fit_finds_the_stiffness_and_what_of_the_tension_arrives(tmp_path: Path) -> None:
    """From finite elements that share nothing with the model."""
    options = ["--simulator", "finite-element", "--frames", "60", "--markers", "40", "--spacing-share", "1.2"]
    drive = "tendon:gain=0.7:delay=0.02"
    made = answer(synth, "bar", "--drive", drive, "--out", tmp_path / "made", *options)
    found = answer(fit, tmp_path / "made", "--spacing", "0.009", "--workers", "1", "--out", tmp_path / "run")
    numbers = found["parameters"]
    assert numbers["tendon.gain"]["value"] == pytest.approx(0.7, rel=0.05)
    assert numbers["tendon.delay"]["value"] == pytest.approx(0.02, abs=0.002)
    assert numbers["tendon.delay"]["unit"] == "s" and numbers["tendon.gain"]["std"] > 0.0
    truth = made["parts"]["bar"]["E"]
    assert numbers["bar.youngs_modulus"]["value"] == pytest.approx(truth, rel=0.06)
    # The other motion was not fitted, and is driven by the same tendon.
    assert found["sequences"]["b"]["predict"]["rms_over_sigma"] < 3.0
