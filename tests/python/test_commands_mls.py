"""The commands on a model that MLS-MPM simulates: each reads the transfer from the run folder."""

from __future__ import annotations

import json

import pytest

from command_example import SPACING, TRUTH, answer, call, make_capture
from mphygs.commands.compare import main as compare
from mphygs.commands.diagnose import main as diagnose
from mphygs.commands.discover import main as discover
from mphygs.commands.extend import main as extend
from mphygs.commands.fit import main as fit
from mphygs.commands.predict import main as predict

COARSE = 2 * SPACING


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = tmp_path_factory.mktemp("mls")
    capture = make_capture(folder / "capture")
    given = answer(fit, capture, "--out", folder / "run", "--transfer", "mls", "--spacing", COARSE)
    return {"folder": folder, "capture": capture, "run": folder / "run", "answer": given}


def test_fit_finds_youngs_modulus_and_says_how_it_was_simulated(fitted: dict) -> None:
    given = fitted["answer"]
    assert given["transfer"] == "mls"
    assert 0.5 < given["parameters"]["bar.youngs_modulus"]["value"] / TRUTH["bar.youngs_modulus"] < 1.5
    assert 1e-5 < given["substep"]["swing"] < 1e-3 and given["substeps"] > 100
    document = json.loads((fitted["run"] / "run.json").read_text())
    assert document["transfer"] == "mls"


def test_resuming_keeps_the_transfer(fitted: dict) -> None:
    again = answer(fit, "--out", fitted["run"], "--resume")
    assert again["transfer"] == "mls" and again["parameters"] == fitted["answer"]["parameters"]


def test_predict_and_compare_simulate_as_the_fit_did(fitted: dict) -> None:
    predicted = answer(predict, fitted["run"])["sequences"]
    compared = answer(compare, fitted["run"])["sequences"]
    for name, ranges in fitted["answer"]["sequences"].items():
        assert predicted[name]["predict"]["rms"] == pytest.approx(ranges["predict"]["rms"], rel=1e-3)
        assert compared[name]["predict"]["rms"] == pytest.approx(ranges["predict"]["rms"], rel=1e-3)
    assert predicted["swing"]["substeps"] > 100


def test_fit_and_compare_tell_the_error_under_feedback_beside_the_free_one(fitted: dict) -> None:
    out = fitted["folder"] / "under"
    options = ["--transfer", "mls", "--spacing", COARSE, "--feedback"]
    given = answer(fit, fitted["capture"], "--out", out, *options)
    compared = answer(compare, out, "--feedback", "0.5")
    for document, gain, ranges in ((given, 1.0, "predict"), (compared, 0.5, "all")):
        assert document["feedback"]["gain"] == gain
        for name, free in document["sequences"].items():
            pulled = document["feedback"]["sequences"][name][ranges]["rms"]
            assert 0.0 < pulled < free[ranges]["rms"]


def test_diagnose_ranks_what_the_transfer_can_have(fitted: dict) -> None:
    found = answer(diagnose, fitted["run"], "--effects", "mass_damping,viscosity,gravity")
    assert {entry["effect"] for entry in found["ranking"]} == {"mass_damping", "viscosity", "gravity"}


def test_extend_refits_with_the_same_transfer(fitted: dict) -> None:
    out = fitted["folder"] / "extended"
    found = answer(extend, fitted["run"], "gravity", "--out", out)
    assert found["steps"][1]["effects"] == ["gravity"]
    assert json.loads((out / "run.json").read_text())["transfer"] == "mls"


def test_discover_takes_the_transfer(fitted: dict) -> None:
    out = fitted["folder"] / "discovered"
    options = ["--transfer", "mls", "--spacing", COARSE, "--effects", "gravity"]
    found = answer(discover, fitted["capture"], "--out", out, *options)
    assert found["verdict"] in ("adequate", "missing", "measurement", "unknown")
    assert json.loads((out / "run.json").read_text())["transfer"] == "mls"


def test_an_effect_that_it_cannot_have_ends_every_command_in_one_line(fitted: dict) -> None:
    out = fitted["folder"] / "refused"
    for main, arguments in (
        (fit, [fitted["capture"], "--transfer", "mls", "--effects", "hold_compliance", "--out", out]),
        (extend, [fitted["run"], "hold_compliance", "--out", out]),
        (diagnose, [fitted["run"], "--effects", "hold_compliance"]),
        (discover, [fitted["capture"], "--transfer", "mls", "--effects", "hold_compliance", "--out", out]),
    ):
        code, said, told = call(main, *arguments)
        assert (code, said) == (2, "") and told.count("\n") == 1
        assert "'hold_compliance': not with --transfer mls" in told and "expected" in told
