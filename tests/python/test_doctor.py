"""The doctor command: what a recording shows and can tell before any fit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from command_example import ETA, FRAMES, SPACING, TRUTH, answer, bar_part, call, make_capture
from mphygs.capture.format import Known, Sensor, load_capture, save_capture
from mphygs.commands import doctor
from mphygs.commands import fit as fit_command
from mphygs.fit.examination import longest_gap, track_frequency
from mphygs.fit.experiment import Experiment
from mphygs.fit.identifiable import Identifiable
from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.of_run import experiment_of
from mphygs.fit.run import load_run
from mphygs.fit.start import starting_belief
from mphygs.simulate.settings import Settings


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("capture"))


def changed(capture: Path, folder: Path, **changes: object) -> Path:
    """The capture with its first sequence's markers changed."""
    own = load_capture(capture)
    swing = own.sequences[0]
    swing = replace(swing, markers=replace(swing.markers, **changes))
    save_capture(replace(own, sequences=(swing, *own.sequences[1:])), folder)
    return folder


def test_a_good_capture_has_nothing_in_the_way(capture: Path) -> None:
    found = answer(doctor.main, capture, "--workers", 1)
    assert found["findings"] == [] and found["motions"] == []
    swing = found["sequences"]["swing"]
    assert (swing["fps"], swing["frames"], swing["markers"], swing["longest_gap"]) == (100.0, 24, 12, 1)
    assert swing["missing"] == pytest.approx(1 / (24 * 12)) and swing["begins"] == "rest"
    assert swing["sigma_seen"] == pytest.approx(1e-4, rel=0.3) and swing["at_rest"] == 4
    stiffness = found["parameters"]["bar.youngs_modulus"]
    assert stiffness["determined"] and stiffness["std"] < 0.01 * stiffness["value"]
    code, out, _ = call(doctor.main, capture, "--workers", 1)
    assert code == 0 and "nothing found that would stand in the way of a fit" in out


def test_expected_errors_are_what_noise_makes_of_a_fit(capture: Path, tmp_path: Path) -> None:
    options = ("--effects", "viscosity", "--out", tmp_path / "run", "--spacing", SPACING, "--workers", 1)
    fitted = answer(fit_command.main, capture, *options)["parameters"]
    experiment, belief = experiment_of(load_run(tmp_path / "run"), workers=1)
    expected = Identifiable.of(experiment, belief).expected()
    noise = covariance(experiment.problem(SPACING).evaluate(belief))
    for p, variance in zip(belief.free, np.diag(noise), strict=True):
        if p.key in (*TRUTH, "viscosity.eta"):
            assert expected[p.key].std == pytest.approx(np.sqrt(variance) * p.slope, rel=0.35)
            assert expected[p.key].std < 1.35 * fitted[p.key]["std"]
    beside = answer(doctor.main, capture, "--effects", "viscosity", "--workers", 1)["parameters"]
    assert 0 < beside["viscosity.eta"]["std"] < ETA


def test_stiffness_over_density_is_all_that_falling_tells(tmp_path: Path) -> None:
    folder = make_capture(tmp_path / "c", known=Known(poissons_ratio=0.4))
    found = answer(doctor.main, folder, "--workers", 1)
    assert not found["parameters"]["bar.youngs_modulus"]["determined"]
    assert any("weigh the object" in line for line in found["findings"])
    # No motion of the hold tells them apart, and none is said to.
    assert found["motions"] and not any(motion["tells"] for motion in found["motions"])
    assert any("measure one of them on its own" in line for line in found["findings"])


def test_a_further_motion_tells_what_a_poor_one_does_not(capture: Path, tmp_path: Path) -> None:
    own = load_capture(capture)
    # Without gravity and without motion of the hold nothing happens at all.
    still = np.broadcast_to(own.sequences[0].markers.at, own.sequences[0].markers.position.shape)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(still.shape)
    swing = replace(own.sequences[0], markers=replace(own.sequences[0].markers, position=still + noise))
    save_capture(replace(own, gravity=np.zeros(3), sequences=(swing,)), tmp_path / "still")
    found = answer(doctor.main, tmp_path / "still", "--workers", 1)
    assert not found["parameters"]["bar.youngs_modulus"]["determined"]
    assert found["motions"][0]["tells"] == ["bar.youngs_modulus"]
    assert any("tells next to nothing" in line for line in found["findings"])
    assert any("gravity is 0 m/s^2" in line for line in found["findings"])


def test_noise_unlike_its_sigma_and_gaps_are_noticed(capture: Path, tmp_path: Path) -> None:
    found = answer(doctor.main, changed(capture, tmp_path / "sigma", sigma=2.5e-5), "--workers", 1)
    (line,) = (line for line in found["findings"] if "the noise is" in line)
    assert line.startswith("swing: ") and "sigma is 0.025 mm" in line
    position = load_capture(capture).sequences[0].markers.position.copy()
    position[6:12, 2:9] = np.nan
    found = answer(doctor.main, changed(capture, tmp_path / "gaps", position=position), "--workers", 1)
    assert found["sequences"]["swing"]["longest_gap"] == 7
    assert any("unseen for 7 frames" in line for line in found["findings"])
    assert any("% of the marker positions are missing" in line for line in found["findings"])


def test_a_force_tells_the_density_and_its_noise_is_looked_at(tmp_path: Path) -> None:
    made = load_capture(make_capture(tmp_path / "c", known=Known(poissons_ratio=0.4)))
    times = np.arange(FRAMES) / 100.0
    noise = 5e-4 * np.random.default_rng(0).standard_normal((FRAMES, 3))
    force = np.array([0.0, 0.0, 0.076]) * (1.0 + 0.5 * np.sin(20.0 * times))[:, None] + noise
    sensor = Sensor("force", force[:, None], np.array([5e-4]), hold=0)
    for sigma, said in ((5e-4, False), (5e-5, True)):
        own = replace(sensor, sigma=np.array([sigma]))
        sequences = (replace(made.sequences[0], sensors=(own,)), made.sequences[1])
        save_capture(replace(made, sequences=sequences), tmp_path / "force")
        found = answer(doctor.main, tmp_path / "force", "--workers", 1, "--no-motions")
        assert found["parameters"]["bar.density"]["determined"]
        assert any("force at hold 0: sigma is stated as 5e-05 N" in f for f in found["findings"]) == said
        assert not any("weigh the object" in line for line in found["findings"])


def test_units_of_another_kind_are_noticed(capture: Path) -> None:
    own = load_capture(capture)
    part = bar_part()
    big = replace(own, parts=(replace(part, vertices=200.0 * part.vertices),))
    (line,) = doctor.object_remarks(big)
    assert "11.3 m across" in line and "in mm, set scale to 0.001" in line
    assert doctor.object_remarks(own) == []


def test_gaps_and_frequencies() -> None:
    seen = np.ones((10, 2), bool)
    seen[:3, 0] = seen[4:7, 1] = False
    assert longest_gap(seen) == 3
    times = np.arange(200) / 100.0
    swing = np.where(times > 0.1, 1.0, 0.0) + 0.2 * np.sin(2 * np.pi * 6.0 * times)
    position = np.repeat(swing[:, None, None], 3, axis=2)
    assert track_frequency(position[20:], 100.0) == pytest.approx(6.0, abs=0.6)
    position[40:43] = np.nan
    # Drifting off is larger than the swing, and no swing.
    drift = 0.2 * times**2 + 0.05 * np.sin(2 * np.pi * 6.0 * times)
    assert track_frequency(np.repeat(drift[:, None, None], 3, axis=2), 100.0) == pytest.approx(6.0, abs=0.5)
    assert track_frequency(position[20:], 100.0) == pytest.approx(6.0, abs=0.6)


def test_violent_motions_tell_nothing(capture: Path) -> None:
    experiment = Experiment.of(load_capture(capture), Settings(0.01, workers=1))
    known = Identifiable.of(experiment, experiment.starting(starting_belief(experiment.capture)))
    swing = experiment.capture.sequence("swing")
    mild = known.of_motion(experiment, swing, 1e-4)
    assert np.allclose(mild, known.of_motion(experiment, swing, 2e-4) * 4.0)
    hold = swing.held[0]
    position = np.zeros((24, 3))
    position[:, 0] = np.linspace(0.0, 0.2, 24) ** 2 / 0.2
    moving = replace(hold, position=position, quaternion=np.tile([1.0, 0, 0, 0], (24, 1)))
    far = replace(swing, held=(moving,))
    assert known.of_motion(experiment, far, 1e-4) is None


def test_bad_input_ends_in_one_line(capture: Path, tmp_path: Path) -> None:
    for arguments, words in (
        ((tmp_path,), "is not a capture; expected a folder with a capture.json"),
        ((capture, "--effects", "magic"), "--effects: unknown effect 'magic'; expected some of"),
    ):
        code, out, said = call(doctor.main, *arguments)
        assert (code, out) == (2, "") and said.count("\n") == 1 and words in said
