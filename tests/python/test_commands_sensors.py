"""Sensors through whole commands: made, fitted, compared, diagnosed, shown."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

import mphygs
from command_example import answer, call
from mphygs.capture.format import load_capture
from mphygs.commands import compare, diagnose, fit, report, synth
from mphygs.compare.sensor_residuals import sensor_lines
from mphygs.fit import checkpointed

SENSORS = "force,torque,acceleration"
SMALL = ("--known", "none", "--frames", 28, "--markers", 24, "--spacing-share", 1.0, "--seed", 3)
COARSE = ("--workers", 1, "--spacing", 0.0065)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bar that is let go and shifted, of which no mass is known, with sensors."""
    out = tmp_path_factory.mktemp("captures") / "bar"
    answer(synth.main, "bar", "--sensors", SENSORS, *SMALL, "--out", out)
    return out


@pytest.fixture(scope="module")
def fitted(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "with"
    answer(fit.main, capture, *COARSE, "--out", out)
    return out


def document(path: Path) -> dict:
    return json.loads(path.read_text())


def test_made_sensors_carry_the_noise_that_is_stated(capture: Path) -> None:
    force, tip = load_capture(capture).sequences[0].sensors
    truth = document(capture / "answer.json")
    assert force.sigma.tolist() == [truth["sensors"]["force"], truth["sensors"]["torque"]]
    assert tip.gravity and tip.sigma == truth["sensors"]["acceleration"]
    # On the mean over the motion the hold bears the bar's weight.
    weight = 9.81 * truth["parts"]["bar"]["mass"]
    assert np.nanmean(force.value[:, 0, 2]) == pytest.approx(weight, rel=0.15)


def test_with_forces_stiffness_and_density_are_told_apart(capture: Path, fitted: Path) -> None:
    truth = document(capture / "answer.json")["parts"]["bar"]
    found = document(fitted / "run.json")["answer"]
    for key, true in (("bar.youngs_modulus", truth["E"]), ("bar.density", truth["rho"])):
        entry = found["parameters"][key]
        assert entry["determined"], entry
        assert abs(entry["value"] - true) < 2.0 * entry["std"], (key, entry, true)
        assert entry["std"] < 0.05 * true, entry
    kinds = [(entry["sensor"], entry["quantity"], entry["unit"]) for entry in found["sensors"]["a"]]
    assert kinds[0] == ("force at hold 0", "force", "N") and kinds[1][1:] == ("torque", "N m")


def test_without_them_markers_tell_the_ratio_alone(capture: Path, tmp_path: Path) -> None:
    bare = tmp_path / "bare"
    shutil.copytree(capture, bare)
    told = document(bare / "capture.json")
    for sequence in told["sequences"]:
        del sequence["sensors"]
    (bare / "capture.json").write_text(json.dumps(told))
    found = answer(fit.main, bare, *COARSE, "--out", tmp_path / "run")
    assert "sensors" not in found
    for key in ("bar.youngs_modulus", "bar.density"):
        assert not found["parameters"][key]["determined"]
        assert "only" in found["parameters"][key]["note"]


def test_a_fit_that_goes_on_ends_at_the_same_bits(
    capture: Path, fitted: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, out = checkpointed.Run.save, tmp_path / "again"

    def broken_off(run: checkpointed.Run) -> None:
        whole(run)
        if len(run.history) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(checkpointed.Run, "save", broken_off)
    assert call(fit.main, capture, *COARSE, "--out", out)[0] == 130
    monkeypatch.undo()
    resumed = answer(fit.main, "--out", out, "--resume")
    assert resumed["parameters"] == document(fitted / "run.json")["answer"]["parameters"]
    one, other = (load_file(folder / "numbers.safetensors") for folder in (out, fitted))
    assert all(one[key].tobytes() == other[key].tobytes() for key in other)


def test_compare_tells_how_far_readings_are_off_and_draws_them(fitted: Path) -> None:
    found = answer(compare.main, fitted, "--workers", 1)
    assert found["adequate"]
    entries = found["sensors"]["a"] + found["sensors"]["b"]
    assert len(entries) == 6
    for entry in entries:
        assert entry["all"]["rms"] < 3.0 * np.sqrt(3.0) * np.hypot(entry["sigma"], entry["grid"])
        assert entry["predict"]["count"] > 5
    assert {Path(path).name for path in found["pictures"]} >= {"a-sensors.png", "b-sensors.png"}
    assert all(Path(path).stat().st_size > 10_000 for path in found["pictures"])
    lines = [" ".join(row) for row in sensor_lines(found["sensors"])]
    assert any("force at hold 0, torque" in line and "N m" in line for line in lines)
    comparison = mphygs.compare(fitted, workers=1)
    assert {row["quantity"] for row in comparison.sensors} == {"force", "torque", "acceleration"}
    assert len(comparison.plot_sensors("b").axes) == 9
    motion = mphygs.simulate(mphygs.Model.of_run(fitted), "b")
    assert [value.shape[1] for value in motion.readings.values()] == [2, 1]


def test_the_report_shows_them(fitted: Path) -> None:
    page = Path(answer(report.main, fitted, "--workers", 1)["report"]).read_text()
    assert "Forces and accelerations" in page and '"chart-sensors"' in page
    data = page.split('id="data">')[1].split("</script>")[0]
    (chart,) = [c for c in json.loads(data)["charts"] if c["id"] == "chart-sensors"]
    assert len(chart["data"]) == 2 * 3 * 3 * 2
    (measured, *_) = chart["data"]
    assert measured["mode"] == "markers" and sum(y is not None for y in measured["y"]) > 5


@pytest.mark.slow
def test_diagnose_scores_with_them(tmp_path: Path) -> None:
    made = tmp_path / "bar"
    answer(synth.main, "bar", "--sensors", SENSORS, *SMALL, "--hidden", "viscosity", "--out", made)
    answer(fit.main, made, *COARSE, "--out", tmp_path / "elastic")
    found = answer(diagnose.main, tmp_path / "elastic", "--workers", 1)
    assert found["ranking"][0]["effect"] == "viscosity", [e["effect"] for e in found["ranking"][:4]]


def test_a_sensor_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    wrong = {"torque": "expected the force beside it", "force:sigma=0": "above zero", "heat": "force"}
    for text, words in wrong.items():
        code, _, err = call(synth.main, "bar", "--sensors", text, "--out", tmp_path / "x")
        assert code == 2 and words in err and err.count("\n") == 1

