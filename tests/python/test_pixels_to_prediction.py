"""A small flower from pixels to prediction, and through the loop with an effect that only the video shows."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from command_example import answer
from mphygs.capture.format import load_capture
from mphygs.capture.stages import STAGES
from mphygs.commands import discover, fit, reconstruct, segment
from mphygs.commands.image_stages import missing_stages
from pictured_example import SHOOT, pictured_flower

track = pytest.importorskip("mphygs.track", reason="the stages that follow motions are not here")

pytestmark = pytest.mark.slow
OPTIONS = ("--spacing", 0.009, "--workers", 1)
SMALLER = ("--control-points", 120)


def stages_of_pixels(capture: Path, run: Path) -> Path:
    """The stages by their commands, smaller than usual."""
    answer(reconstruct.main, capture, "--out", run, "--iterations", 500, "--most-gaussians", 3000)
    answer(segment.main, capture, "--out", run, "--features", "colour", "--particles", 6000)
    answer(track.main, capture, "--out", run, *SMALLER)
    assert missing_stages(load_capture(capture), run / STAGES) == []
    return run


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    shoot = replace(SHOOT, frames=32, rest_views=14)
    folder = tmp_path_factory.mktemp("flower") / "daisy"
    return pictured_flower(folder, hidden=("air_drag:c_d=40",), shoot=shoot)


@pytest.fixture(scope="module")
def stages(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stages_of_pixels(capture, tmp_path_factory.mktemp("stages"))


def test_pixels_become_a_prediction(capture: Path, stages: Path, tmp_path: Path) -> None:
    options = ("--effects", "air_drag", "--prestress", "paper", *OPTIONS)
    found = answer(fit.main, capture, "--out", tmp_path / "run", "--stages", stages, *options)
    for name, label in (("frog", "fit"), ("frog", "predict"), ("turned", "predict")):
        error = found["sequences"][name][label]
        assert error["rms"] < 1.5e-3 and error["iou"] > 0.75 and error["chamfer_px"] < 0.5
    truth = json.loads((capture / "answer.json").read_text())["parts"]
    mass = found["parameters"]
    assert len([key for key in mass if key.endswith("youngs_modulus")]) >= 2 and len(truth) == 4
    assert 10.0 < found["parameters"]["air_drag.c_d"]["value"] < 160.0


def test_the_loop_finds_what_only_the_video_shows(capture: Path, stages: Path, tmp_path: Path) -> None:
    options = ("--effects", "air_drag,gravity", *OPTIONS)
    found = answer(discover.main, capture, "--out", tmp_path / "loop", "--stages", stages, *options)
    last = found["steps"][-1]
    assert last["effects"] == ["air_drag"], "drag, and not gravity, which explains nearly as much"
    assert 20.0 < last["parameters"]["air_drag.c_d"]["value"] < 80.0, "40 is the truth"
    # The shape found in pictures this small (a stem with a third of its volume missing) leaves an error near
    # the limit up to which a model counts as enough: with true tracks it stays, with the true shape it goes.
    # So whether the loop calls its last model enough is left open, but not what it calls missing then.
    assert (found["verdict"], found["effects"]) in (("missing", ["air_drag"]), ("unknown", []))
    before, after = (found["steps"][k]["sequences"]["frog"]["predict"]["rms"] for k in (0, -1))
    assert after < 0.6 * before
