"""A stem and its petal at real stiffness, rod and shell, through `fit`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bar_capture import bar_belief
from command_example import answer
from mphygs.capture.format import Capture, save_capture
from mphygs.capture.meshes import Part
from mphygs.capture.record import Known
from mphygs.commands import fit as command
from mphygs.simulate.prediction import Predictor
from mphygs.simulate.settings import Settings
from thin_meshes import held_capture, leaf, tube_mesh

SPACING, LENGTH, FRAMES = 0.005, 0.06, 16
TRUTH = {"stem": 3e8, "petal": 5e6}


def stem_and_petal() -> list[Part]:
    """A stem of 3 mm along z, a petal of 0.3 mm that its side goes into."""
    line = np.stack([np.linspace(-0.01, LENGTH, 36), *np.zeros((2, 36))], axis=1)
    vertices, faces = tube_mesh(line, 0.0015, sides=16)
    petal = leaf(0.03, 0.018, 3e-4, curl=15.0, cup=15.0)
    return [
        Part("stem", vertices[:, [1, 2, 0]], faces, shape="rod"),
        Part("petal", petal.vertices + [0.0, 0.0, LENGTH - 0.004], petal.faces, shape="shell"),
    ]


def moved_flower() -> Capture:
    """Moved at its foot, 0.1 mm of noise."""
    parts, generator = stem_and_petal(), np.random.default_rng(3)
    places = []
    for part in parts:
        middle = part.vertices[part.faces].mean(1)
        middle = middle[middle[:, 2] > 0.004]
        places.append(middle[generator.choice(len(middle), 8, replace=False)])
    times = np.arange(FRAMES) / 60.0
    motion = np.zeros((FRAMES, 3))
    motion[:, 0] = 0.012 * np.sin(2 * np.pi * 3.0 * times) * np.minimum(times / 0.1, 1.0)
    motion[:, 2] = 0.5 * motion[:, 0]
    capture = held_capture(
        parts, box=[[-1, -1, -1], [1, 1, 0]], frames=FRAMES, motion=motion, markers=np.concatenate(places),
        fit=(0, FRAMES), gravity=(0.0, 0.0, -9.81), rest="equilibrium",
    )  # fmt: skip
    known = Known(density={part.name: 800.0 for part in parts}, poissons_ratio=0.3)
    capture = replace(capture, known=known)
    moduli = [TRUTH[p.name] for p in parts]
    truth = bar_belief(capture, youngs_modulus=moduli, density=800.0, prestress="equilibrium")
    (recording,) = capture.sequences
    settings = Settings(SPACING, workers=1, dtype="float64")
    predictor = Predictor(capture, recording, settings)
    predictor.steps_a_frame = 32  # a truth whose steps are not to be seen
    position = predictor.predict(truth).position
    position = position + 1e-4 * generator.standard_normal(position.shape)
    markers = replace(recording.markers, position=position)
    return replace(capture, sequences=(replace(recording, markers=markers),))


def test_a_pull_that_the_rest_shape_carries_too_has_the_slope_of_differences() -> None:
    # More gravity, and a rest shape that carries it, change forces that cancel where nothing moves yet.
    capture, last = moved_flower(), 6
    predictor = Predictor(capture, capture.sequences[0], Settings(SPACING, workers=1, dtype="float64"))
    moduli = [TRUTH[p.name] for p in capture.parts]
    belief = bar_belief(
        capture, youngs_modulus=moduli, density=800.0, prestress="equilibrium", free=()
    ).with_effect("gravity")
    key, step = "gravity.delta_g_x", 0.01
    slope = predictor.predict(belief, last=last, keys=(key,)).jacobian[..., 0]
    more, less = (
        predictor.predict(belief.with_parameter(key, value=at), last=last).position for at in (step, -step)
    )
    difference = (more - less) / (2.0 * step) * belief[key].scale  # slopes are by the coordinate
    assert np.abs(difference).max() > 1e-6
    assert slope == pytest.approx(difference, abs=1e-5 * np.abs(difference).max())


@pytest.mark.slow
def test_a_stem_and_a_petal_sixty_times_softer_are_found(tmp_path: Path) -> None:
    save_capture(moved_flower(), tmp_path / "flower")
    options = ("--out", tmp_path / "run", "--spacing", SPACING, "--workers", 1)
    found = answer(command.main, tmp_path / "flower", *options)
    error = found["sequences"]["a"]["fit"]["rms_over_sigma"]
    assert error < 1.1
    for part, value in TRUTH.items():
        own = found["parameters"][f"{part}.youngs_modulus"]
        assert own["determined"] and own["value"] == pytest.approx(value, rel=0.1)
