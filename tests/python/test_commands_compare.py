"""The compare and predict commands, and the one name for all commands."""

import io
import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from command_example import FRAMES, SIGMA, SPACING, answer, call, make_capture
from mphygs.capture.format import load_capture, save_capture
from mphygs.commands import command_table as all_commands
from mphygs.commands import compare as command
from mphygs.commands import fit, predict
from mphygs.commands.console import Console
from mphygs.compare.metrics import point_error
from mphygs.compare.sequence_pictures import moving_most, spectrum


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("capture"))


@pytest.fixture(scope="module")
def elastic(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "elastic"
    answer(fit.main, capture, "--out", out, "--spacing", SPACING)
    return out


@pytest.fixture(scope="module")
def viscous(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "viscous"
    answer(fit.main, capture, "--effects", "viscosity", "--out", out, "--spacing", SPACING)
    return out


def test_error_of_noise_and_of_a_shift() -> None:
    noise = SIGMA * np.random.default_rng(0).standard_normal((400, 30, 3))
    noise[3, 4, 1] = np.nan
    error = point_error(noise, np.zeros_like(noise), SIGMA)
    assert error.rms_over_sigma == pytest.approx(1.0, abs=0.02)
    assert error.rms == pytest.approx(SIGMA * np.sqrt(3), rel=0.02)
    assert error.count == 400 * 30 - 1
    shifted = point_error(np.zeros((5, 2, 3)), np.full((5, 2, 3), [3.0, 4.0, 0.0]), 1.0, slice(1, 3))
    assert (shifted.rms, shifted.max, shifted.count) == (5.0, 5.0, 4)
    assert point_error(np.full((2, 1, 3), np.nan), np.zeros((2, 1, 3)), 1.0) is None
    with pytest.raises(ValueError, match="as measured"):
        point_error(np.zeros((2, 1, 3)), np.zeros((2, 2, 3)), 1.0)


def test_tells_noise_from_more(elastic: Path, viscous: Path) -> None:
    wrong, right = answer(command.main, elastic), answer(command.main, viscous)
    assert set(right) >= {"sequences", "adequate", "p_value", "where", "when", "budget"}
    assert right["adequate"] is True and wrong["adequate"] is False
    assert wrong["p_value"] < 1e-6 < right["p_value"]
    assert wrong["where"][0]["part"] == "bar"
    assert right["where"] == [] and right["when"] == []
    assert set(right["budget"]) == {"noise", "discretisation", "physics"}
    assert right["budget"]["noise"] == pytest.approx(SIGMA * np.sqrt(3), rel=0.2)
    assert right["budget"]["physics"] < 0.5 * wrong["budget"]["physics"]
    for label in ("fit", "predict", "all"):
        now, before = (document["sequences"]["swing"][label] for document in (right, wrong))
        assert now["rms"] < before["rms"] and now["count"] == before["count"]
    assert json.loads((elastic / "comparison.json").read_text())["adequate"] is False


def test_draws_a_picture_of_every_sequence(viscous: Path, tmp_path: Path) -> None:
    found = answer(command.main, viscous, "--out", tmp_path, "--sequences", "swing")
    assert found["pictures"] == [str(tmp_path / "swing.png")]
    assert list(found["sequences"]) == ["swing"]
    image = cv2.imread(found["pictures"][0])
    assert image.shape[0] > 500 and image.std() > 10


def test_markers_that_move_most_and_their_spectrum() -> None:
    times = np.arange(64) / 64.0
    tracks = np.zeros((64, 3, 3))
    tracks[:, 1, 2] = 2.0 * np.sin(2 * np.pi * 8 * times)
    tracks[:, 2, 0] = 1.0 * np.sin(2 * np.pi * 4 * times)
    tracks[5, 1] = np.nan
    assert moving_most(tracks, 2) == [(1, 2), (2, 0)]
    frequency, amplitude = spectrum(tracks[:, 1, 2], 64.0)
    assert frequency[amplitude.argmax()] == 8.0
    assert amplitude.max() == pytest.approx(2.0, rel=0.05)


def test_predicts_every_frame(viscous: Path, capture: Path, tmp_path: Path) -> None:
    found = answer(predict.main, viscous, "--out", tmp_path)
    assert list(found["sequences"]) == ["swing", "other"]
    measured = load_capture(capture).sequence("other").markers.position
    with np.load(found["sequences"]["other"]["file"]) as arrays:
        assert arrays["position"].shape == measured.shape
        assert arrays["surface"].shape[::2] == (FRAMES, 3)
        rms = np.sqrt(np.nanmean(((arrays["position"] - measured) ** 2).sum(-1)))
        speed = np.gradient(arrays["position"], arrays["times"], axis=0)[2:-2]
        assert np.abs(speed - arrays["velocity"][2:-2]).max() < 0.1 * np.abs(speed).max()
    assert rms == pytest.approx(found["sequences"]["other"]["all"]["rms"], rel=1e-3)


def test_predicts_a_sequence_without_markers_of_another_capture(
    viscous: Path, capture: Path, tmp_path: Path
) -> None:
    known = load_capture(capture)
    blank = replace(known.sequence("swing"), name="blank", markers=None, fit=(0, 0), release=2)
    other = replace(known, sequences=(blank, known.sequence("other")))
    save_capture(other, tmp_path / "capture")
    found = answer(predict.main, viscous, "--capture", tmp_path / "capture", "--out", tmp_path / "out")
    assert found["sequences"]["blank"]["markers"] == 0
    assert found["sequences"]["other"]["all"]["rms_over_sigma"] < 1.1
    compared = answer(command.main, viscous, "--capture", tmp_path / "capture", "--out", tmp_path / "out")
    assert list(compared["sequences"]) == ["other"]


def test_faults_end_in_one_line_and_2(viscous: Path, capture: Path, tmp_path: Path) -> None:
    for main, arguments, words in (
        (command.main, [tmp_path], "is not a run"),
        (command.main, [viscous, "--sequences", "none"], 'no sequence "none"'),
        (predict.main, [viscous, "--sequences", "none"], 'no sequence "none"'),
        (predict.main, [], "Missing"),
    ):
        code, out, err = call(main, *arguments)
        assert (code, out) == (2, ""), err
        assert words in err and err.count("\n") == 1
    document = json.loads((viscous / "run.json").read_text())
    (tmp_path / "run.json").write_text(json.dumps(document | {"digest": "0"}))
    (tmp_path / "numbers.safetensors").write_bytes((viscous / "numbers.safetensors").read_bytes())
    code, _, err = call(command.main, tmp_path)
    assert code == 2 and "has changed since" in err


def test_one_name_for_all_commands(viscous: Path, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    line = ["compare", str(viscous), "--json", "--sequences", "swing", "--out", str(tmp_path)]
    assert all_commands.main(line) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["adequate"] is True and answer["warnings"] == []
    assert all_commands.main(["guess"]) == 2
    assert "unknown command 'guess'; expected one of reconstruct, segment, fit" in capsys.readouterr().err
    assert all_commands.main(["--help"]) == 0
    assert "discover" in capsys.readouterr().out


def test_a_doubted_sigma_stands_in_the_text_and_the_json(
    viscous: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(command, "doubted_sigma", lambda compared: [f"{', '.join(compared)}: too small"])
    options = command.CompareOptions(run=viscous, sequences="swing", out=tmp_path)
    told = command.compare_command(options, Console(io.StringIO()))
    assert told.document["warnings"] == ["swing: too small"]
    assert "warning: swing: too small" in told.text.splitlines()


def test_an_interrupt_while_a_command_loads_is_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(_name: str) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(all_commands.importlib, "import_module", interrupted)
    assert all_commands.main(["fit"]) == 130
    assert capsys.readouterr().err == "mphygs fit: interrupted\n"
