"""Sensors of a capture: read, written, and refused in one line each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from capture_example import FRAMES, Example
from mphygs.capture.format import load_capture, save_capture

RANDOM = np.random.default_rng(3)
FORCE, TORQUE = RANDOM.standard_normal((2, FRAMES, 3))
ACCELERATION = np.array([0.0, 0.0, 9.81]) + 0.1 * RANDOM.standard_normal((FRAMES, 3))


@pytest.fixture
def example(tmp_path: Path) -> Example:
    example = Example(tmp_path)
    np.savez(tmp_path / "force.npz", force=FORCE)
    np.savez(tmp_path / "wrench.npz", force=FORCE, torque=TORQUE)
    np.savez(tmp_path / "imu.npz", acceleration=ACCELERATION)
    example.sequence["sensors"] = [
        {"kind": "force", "hold": 0, "file": "wrench.npz", "sigma": 0.02, "torque_sigma": 1e-3},
        {"kind": "force", "hold": 0, "file": "force.npz"},
        {"kind": "acceleration", "at": [0.09, 0.0, 0.01], "file": "imu.npz", "gravity": True, "sigma": 0.1},
    ]
    return example


def test_sensors_are_read_and_written_equal(example: Example, tmp_path: Path) -> None:
    capture = example.load()
    both, alone, tip = capture.sequences[0].sensors
    np.testing.assert_array_equal(both.value, np.stack([FORCE, TORQUE], axis=1))
    assert both.quantities == ("force", "torque") and both.sigma.tolist() == [0.02, 1e-3] and both.hold == 0
    assert alone.value.shape == (FRAMES, 1, 3) and np.isnan(alone.sigma).all()
    np.testing.assert_array_equal(tip.value[:, 0], ACCELERATION)
    assert tip.gravity and tip.at.tolist() == [0.09, 0.0, 0.01] and tip.quantities == ("acceleration",)
    assert capture.sequences[1].sensors == ()
    save_capture(capture, tmp_path / "again")
    for a, b in zip(load_capture(tmp_path / "again").sequences[0].sensors, (both, alone, tip), strict=True):
        np.testing.assert_array_equal(a.value, b.value)
        np.testing.assert_array_equal(a.sigma, b.sigma)
        assert (a.kind, a.hold, a.gravity, a.label) == (b.kind, b.hold, b.gravity, b.label)


def change(number: int, **values: object) -> Callable[[Example], object]:
    """Values of a sensor, None takes a key away."""

    def spoil(example: Example) -> None:
        sensor = example.sequence["sensors"][number]
        for key, value in values.items():
            sensor.pop(key, None)
            if value is not None:
                sensor[key] = value

    return spoil


def file_of(number: int, **arrays: np.ndarray) -> Callable[[Example], object]:
    """Another file of a sensor."""

    def spoil(example: Example) -> None:
        np.savez(example.folder / "other.npz", **arrays)
        example.sequence["sensors"][number]["file"] = "other.npz"

    return spoil


INFINITE = np.where(np.arange(FRAMES)[:, None] == 4, np.inf, FORCE)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (change(0, hold=1), "sensors[0].hold: is 1; expected one of held, 0 to 0"),
        (change(0, hold=-1), "sensors[0].hold: is -1"),
        (change(0, hold=None), '"hold" is missing'),
        (change(0, kind="pressure"), 'sensors[0].kind: is "pressure"; expected one of force, acceleration'),
        (change(0, sigma=0.0), "sensors[0].sigma: is 0"),
        (change(0, torque_sigma=-1.0), "sensors[0].torque_sigma: is -1"),
        (change(1, torque_sigma=1.0), "sensors[1].torque_sigma: stands beside force.npz"),
        (change(0, at=[0, 0, 0]), 'sensors[0].at: stands at a sensor of kind "force"'),
        (change(2, hold=0), 'sensors[2].hold: stands at a sensor of kind "acceleration"'),
        (change(2, at=None), '"at" is missing'),
        (change(2, at=[0.2, 0.0, 0.0]), "sensors[2].at: lies 0.1 m from the object"),
        (change(2, gravity=None), "is false, but the sensor reads 9.8"),
        (change(2, sigma=-0.1), "sensors[2].sigma: is -0.1"),
        (change(2, file="nowhere.npz"), '"nowhere.npz" does not exist'),
        (change(0, unit="N"), "sensors[0].unit: unknown key"),
        (file_of(0, force=FORCE[1:]), "force: has 11 frames; expected 12, as the sequence"),
        (file_of(0, force=FORCE, torque=TORQUE[:, :2]), "torque: has shape (12, 2)"),
        (file_of(0, torque=TORQUE), 'array "force" is missing'),
        (file_of(0, force=INFINITE), "force: is infinite at [4, 0]"),
        (file_of(0, force=np.full((FRAMES, 3), np.nan)), "force: is NaN everywhere"),
        (file_of(0, force=FORCE, moment=TORQUE), "moment: unknown array"),
        (file_of(1, force=1e9 * FORCE), "sensors[1].file: reads up to"),
        (file_of(2, acceleration=0.01 * ACCELERATION), "is true, but the sensor reads 0.0"),
        (lambda e: e.sequence.pop("markers") and e.sequence.pop("fit"), "sensors: stand alone"),
    ],
)
def test_bad_sensors_are_refused_in_one_line(
    example: Example, spoil: Callable[[Example], object], words: str
) -> None:
    assert words in example.complaint(spoil)


def test_a_force_without_holds_is_refused(example: Example) -> None:
    example.sequence["held"] = []
    assert "expected a hold, of which there is none" in example.complaint()


def test_an_archive_that_is_none_is_refused(example: Example) -> None:
    (example.folder / "force.npz").write_bytes(b"no archive")
    assert "force.npz" in example.complaint()
