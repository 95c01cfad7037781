"""The fit command: its JSON, its exit codes, its run folder, stopping and resuming."""

import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file

from command_example import ETA, SIGMA, SPACING, TRUTH, answer, call, make_capture
from mphygs.capture.format import Known
from mphygs.commands import fit as command
from mphygs.commands import fit_begun, predict
from mphygs.fit import checkpointed
from mphygs.fit.levenberg_marquardt import covariance
from mphygs.fit.of_run import experiment_of
from mphygs.fit.run import load_run
from mphygs.simulate.errors import SimulationError

OPTIONS = ("--spacing", SPACING, "--workers", 1)


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("capture"))


@pytest.fixture(scope="module")
def fitted(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> dict:
    out = tmp_path_factory.mktemp("runs") / "viscous"
    return answer(command.main, capture, "--effects", "viscosity", "--out", out, *OPTIONS)


def test_finds_the_truth_within_its_errors(fitted: dict) -> None:
    experiment, belief = experiment_of(load_run(Path(fitted["run"])))
    noise = covariance(experiment.problem(SPACING).evaluate(belief))
    own = {p.key: std * p.slope for p, std in zip(belief.free, np.sqrt(np.diag(noise)), strict=True)}
    for key, truth in {**TRUTH, "viscosity.eta": ETA}.items():
        entry = fitted["parameters"][key]
        assert entry["determined"]
        # On so coarse a grid most of the error is what a finer one would change; the truth is of this grid.
        assert 0 < own[key] < 0.1 * truth and own[key] <= entry["std"] < 0.3 * truth
        assert abs(entry["value"] - truth) < 3 * own[key]
    assert fitted["parameters"]["viscosity.eta"]["unit"] == "Pa s"


def test_json_has_the_documented_shape(fitted: dict) -> None:
    assert {"run", "parameters", "seconds", "substeps", "sequences"} <= set(fitted)
    assert set(fitted["sequences"]) == {"swing", "other"}
    assert fitted["sequences"]["other"]["fit"] is None
    for ranges in (fitted["sequences"]["swing"]["fit"], fitted["sequences"]["swing"]["predict"]):
        assert set(ranges) == {"rms", "max", "rms_over_sigma", "count"}
        assert ranges["rms_over_sigma"] == pytest.approx(1.0, abs=0.1)
        assert ranges["rms"] == pytest.approx(ranges["rms_over_sigma"] * SIGMA * np.sqrt(3))
    assert fitted["sequences"]["swing"]["fit"]["count"] == 16 * 12 - 1
    assert fitted["substeps"] > 50


def test_what_follows_the_last_stage_is_told_while_it_goes_on(fitted: dict, tmp_path: Path) -> None:
    folder = shutil.copytree(fitted["run"], tmp_path / "run")
    code, _, said = call(command.main, "--out", folder, "--resume", "--workers", 1)
    assert code == 0
    told = re.findall(r"^\[ *(\d+) %, .*\] (.*)$", said, re.MULTILINE)
    shares, lines = [int(share) for share, _ in told], [line for _, line in told]
    assert shares == sorted(shares) and shares[-1] > 85
    expected = [
        *(f"how far {key} can be moved" for key in ("bar.youngs_modulus", "viscosity.eta")),
        *(f"predicting {name}" for name in ("swing", "other")),
        *(f"what an error of {name}" for name in ("clock", "lengths", "thickness", "gravity")),
    ]
    for words in expected:
        assert any(line.startswith(words) for line in lines), words


def test_intervals_can_be_asked_for_afterwards(fitted: dict, tmp_path: Path) -> None:
    folder = shutil.copytree(fitted["run"], tmp_path / "run")
    again = answer(command.main, "--out", folder, "--resume", "--intervals", "--workers", 1)
    assert set(again["parameters"]) == set(fitted["parameters"])
    experiment, belief = experiment_of(load_run(folder))
    noise = covariance(experiment.problem(SPACING).evaluate(belief))
    for p, variance in zip(belief.free, np.diag(noise), strict=True):
        entry = again["parameters"][p.key]
        low, high = entry.pop("interval")
        assert entry == fitted["parameters"][p.key]
        assert low < entry["value"] < high
        # Of the noise: what the grid does is no part of the likelihood.
        assert high - low == pytest.approx(4.0 * np.sqrt(variance) * p.slope, rel=0.2)
    code, out, _ = call(command.main, "--out", folder, "--resume", "--intervals", "--workers", 1)
    assert code == 0
    assert "interval (2 sd)" in out


def test_no_intervals_of_pictures(
    capture: Path, fitted: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = shutil.copytree(fitted["run"], tmp_path / "run")
    document = json.loads((folder / "run.json").read_text()) | {"stages": str(tmp_path)}
    (folder / "run.json").write_text(json.dumps(document))
    # Before any stage is run, of a new fit as of one that is resumed.
    monkeypatch.setattr(fit_begun, "has_stages", lambda _: True)
    monkeypatch.setattr(fit_begun, "run_stages", lambda *_: pytest.fail("a stage was run"))
    for arguments in ((capture, "--out", tmp_path / "new"), ("--out", folder, "--resume")):
        code, _, said = call(command.main, *arguments, "--intervals")
        assert code == 2
        assert "--intervals: got a capture in pictures; expected one with markers" in said


def test_run_folder_holds_the_same_numbers_twice(fitted: dict) -> None:
    folder = Path(fitted["run"])
    document = json.loads((folder / "run.json").read_text())
    numbers = load_file(folder / "numbers.safetensors")
    assert numbers["values"].tolist() == [p["value"] for p in document["belief"]["parameters"]]
    run = load_run(folder)
    assert run.complete and run.belief.effects == ("viscosity",)
    std = np.sqrt(np.diag(run.covariance))
    stated = fitted["parameters"]["bar.youngs_modulus"]["std"]
    assert std[0] * run.belief.free[0].slope == pytest.approx(stated)
    assert document["versions"]["numpy"] == np.__version__
    assert [stage["name"] for stage in document["history"]][-1] == "fine"


def test_same_options_same_numbers_and_resume_too(
    fitted: dict, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "again"
    whole = checkpointed.Run.save

    def broken_off(run: checkpointed.Run) -> None:
        whole(run)
        if len(run.history) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(checkpointed.Run, "save", broken_off)
    code, stdout, stderr = call(
        command.main, capture, "--effects", "viscosity", "--out", out, "--spacing", SPACING, "--workers", 2
    )
    assert code == 130 and stdout == ""
    assert f"mphygs fit --out {out} --resume" in stderr.splitlines()[-1]
    monkeypatch.undo()
    assert not load_run(out).complete
    resumed = answer(command.main, "--out", out, "--resume")
    assert resumed["parameters"] == fitted["parameters"]
    assert resumed["sequences"] == fitted["sequences"]
    one, other = (load_file(Path(folder) / "numbers.safetensors") for folder in (out, fitted["run"]))
    assert all(one[key].tobytes() == other[key].tobytes() for key in other)


@pytest.mark.slow
@pytest.mark.parametrize("optimiser", ["adam", "lbfgs"])
def test_gradients_end_at_the_same_minimum(
    optimiser: str, fitted: dict, capture: Path, tmp_path: Path
) -> None:
    options = ("--effects", "viscosity", "--optimiser", optimiser, *OPTIONS)
    found = answer(command.main, capture, *options, "--out", tmp_path / "run")["parameters"]
    for key, entry in fitted["parameters"].items():
        assert abs(found[key]["value"] - entry["value"]) < entry["std"]


def test_resume_wants_the_same_options(fitted: dict) -> None:
    code, _, stderr = call(command.main, "--out", fitted["run"], "--resume", "--frames", "0:9")
    assert code == 2
    assert "--frames" in stderr and "same options" in stderr


def test_interrupt_from_outside(capture: Path, tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "mphygs.fit", capture, "--out", tmp_path / "run", "--spacing", "0.004"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )  # fmt: skip
    for _ in range(600):
        if (tmp_path / "run" / "run.json").exists():
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    stdout, stderr = process.communicate(timeout=60)
    assert process.returncode == 130, stderr
    assert stdout == ""
    expected = f"mphygs fit: interrupted; continue with: mphygs fit --out {tmp_path}/run --resume"
    assert stderr.splitlines()[-1] == expected


def test_says_what_gravity_alone_does_not_tell(tmp_path: Path) -> None:
    folder = make_capture(tmp_path / "capture", known=Known(poissons_ratio=0.4), eta=0.0)
    found = answer(command.main, folder, "--out", tmp_path / "run", *OPTIONS)["parameters"]
    for key in ("bar.youngs_modulus", "bar.density"):
        assert found[key]["determined"] is False
        assert found[key]["note"] == "the data determine bar.youngs_modulus / bar.density only"
    ratio = found["bar.youngs_modulus"]["value"] / found["bar.density"]["value"]
    assert ratio == pytest.approx(TRUTH["bar.youngs_modulus"] / 1000.0, rel=0.02)
    code, out, _ = call(command.main, "--out", tmp_path / "run", "--resume")
    assert code == 0
    assert sum("NOT DETERMINED" in line for line in out.splitlines()) == 2


def test_release_of_an_unfitted_sequence_is_found(tmp_path: Path) -> None:
    folder = make_capture(tmp_path / "capture", release=3)
    document = json.loads((folder / "capture.json").read_text())
    document["sequences"][1]["release"] = 2  # stated one frame early
    (folder / "capture.json").write_text(json.dumps(document))
    found = answer(command.main, folder, "--effects", "viscosity", "--out", tmp_path / "run", *OPTIONS)
    assert list(found["parameters"]) == ["bar.youngs_modulus", "swing.release_shift", "viscosity.eta"]
    assert found["sequences"]["other"]["predict"]["rms_over_sigma"] < 1.15
    # With no frames to judge by either, all of them say when it was let go.
    del document["sequences"][1]["predict"], document["sequences"][1]["fit"]
    (folder / "capture.json").write_text(json.dumps(document))
    answer(command.main, folder, "--effects", "viscosity", "--out", tmp_path / "bare", *OPTIONS)
    predicted = answer(predict.main, tmp_path / "bare")["sequences"]
    assert predicted["other"]["frames"] == predicted["swing"]["frames"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--effects", "magic"], "unknown effect 'magic'; expected some of air_drag"),
        (["--sequences", "none"], 'no sequence "none"; expected one of swing, other'),
        (["--sequences", "other"], "no sequence has markers and frames to fit"),
        (["--frames", "3"], "expected i:j"),
        (["--frames", "5:99"], "0 <= i < j <= 24"),
        (["--spacing", "-1"], "a length above zero [m]"),
        (["--spacing", "1e-5"], "--spacing: got 1e-05 m; expected 0.00"),
        (["--spacing", "wide"], "could not convert string to float"),
        (["--effects", "contact"], "mphygs extend"),
        (["--colour", "red"], "--colour"),
        (["--transfer", "sph"], "--transfer"),
        (["--workers", "0"], "--workers: got 0; expected 1 or more"),
        (["--seed", "-1"], "--seed: got -1; expected 0 or more"),
    ],
)
def test_faulty_options_end_in_one_line_and_2(
    arguments: list[str], words: str, capture: Path, tmp_path: Path
) -> None:
    code, out, err = call(command.main, capture, "--out", tmp_path / "run", *arguments)
    assert (code, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1 and "Traceback" not in err
    assert not (tmp_path / "run").exists()


def test_faulty_input_ends_in_one_line_and_2(tmp_path: Path) -> None:
    code, _, err = call(command.main, tmp_path / "nowhere")
    assert code == 2 and "expected a folder with a capture.json" in err and err.count("\n") == 1
    (tmp_path / "kept.txt").write_text("mine")
    code, _, err = call(command.main, make_capture(tmp_path / "capture"), "--out", tmp_path)
    assert code == 2 and "expected a run folder, or a new one" in err
    assert (tmp_path / "kept.txt").read_text() == "mine"


def test_unstable_simulation_ends_in_1(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unstable(*_: object, **__: object) -> None:
        raise SimulationError("frame 3, part bar: unstable")

    monkeypatch.setattr(command, "fit_run", unstable)
    code, out, err = call(command.main, capture, "--out", tmp_path / "run", "--json", *OPTIONS)
    assert (code, out) == (1, "")
    assert err.splitlines()[-1] == "mphygs fit: frame 3, part bar: unstable"


def edited(folder: Path, keys: tuple[str, ...], value: object) -> None:
    """Put a value where the keys lead in a folder's run.json."""
    document = json.loads((folder / "run.json").read_text())
    inner = document
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    (folder / "run.json").write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("keys", "value", "words"),
    [
        (("ranges",), {"nobody": [0, 5]}, "sequence 'nobody'; expected some of swing, other"),
        (("ranges", "swing"), [0, 1000], "fitted frames 0:1000 of swing"),
        (("left_out",), {"swing": [[0, 999]]}, "measurement (0, 999) of swing left out"),
    ],
)
def test_runs_of_what_their_capture_has_not_are_refused(
    keys: tuple[str, ...], value: object, words: str, fitted: dict, tmp_path: Path
) -> None:
    for name in ("run.json", "numbers.safetensors"):
        (tmp_path / name).write_bytes((Path(fitted["run"]) / name).read_bytes())
    capture = Path(fitted["run"]) / json.loads((tmp_path / "run.json").read_text())["capture"]
    edited(tmp_path, ("capture",), str(capture.resolve()))
    edited(tmp_path, keys, value)
    with pytest.raises(ValueError) as caught:
        experiment_of(load_run(tmp_path))
    assert words in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda f: (f / "run.json").write_text("{"), "expected valid JSON"),
        (lambda f: (f / "run.json").write_text("[" * 100_000), "nested too deep; expected valid JSON"),
        (lambda f: (f / "run.json").write_text('{"format": "other"}'), 'expected "mphygs-run/1"'),
        (lambda f: (f / "run.json").write_text('{"format": "mphygs-run/1"}'), '"options" is missing'),
        (lambda f: (f / "run.json").unlink(), "is not a run"),
        (lambda f: edited(f, ("options",), None), "options: is null; expected an object"),
        (lambda f: edited(f, ("settings", "spacing"), "abc"), 'spacing: is "abc"; expected a number'),
        (lambda f: edited(f, ("settings", "spacing"), -1), "spacing: is -1; expected a length above zero"),
        (lambda f: edited(f, ("settings", "safety"), "x"), 'safety: is "x"; expected a number'),
        (lambda f: edited(f, ("settings", "safety"), 1e9), "safety: is 1000000000.0; expected a share"),
        (lambda f: edited(f, ("settings", "dtype"), "int8"), 'dtype: is "int8"; expected one of float32'),
        (lambda f: edited(f, ("settings", "memory_budget"), "2 GB"), "is .*; expected an int"),
        (
            lambda f: edited(f, ("settings", "memory_budget"), 1 << 60),
            "is .*; expected 1048576",
        ),
        (lambda f: edited(f, ("settings", "more"), 1), "settings.more: unknown key"),
        (lambda f: edited(f, ("transfer",), "sph"), 'transfer: is "sph"; expected one of'),
        (lambda f: edited(f, ("ranges",), {}), "ranges: is empty; expected the frames fitted"),
        (lambda f: edited(f, ("ranges", "swing"), [0, "x"]), r'swing\[1\]: is "x"; expected an integer'),
        (lambda f: edited(f, ("left_out",), {"swing": [[0]]}), "expected two whole numbers"),
        (lambda f: edited(f, ("seed",), -1), "seed: is -1; expected a whole number"),
        (lambda f: edited(f, ("capture",), "x" * 5000), "capture: is a text of 5000 characters"),
        (lambda f: edited(f, ("capture",), "a\x1b[2Jb"), "capture: holds characters that do not print"),
        (lambda f: edited(f, ("history", 0, "seconds"), "long"), "seconds: is .*; expected a number"),
        (
            lambda f: edited(f, ("belief", "parameters", 0, "value"), "soft"),
            "is .*; expected a number",
        ),
        (lambda f: edited(f, ("belief", "parameters", 0, "value"), 1e300), "a youngs_modulus from"),
        (lambda f: edited(f, ("belief", "gravity"), [0, 0, 1e9]), "gravity: is too strong"),
        (lambda f: edited(f, ("belief", "law"), "none"), "law: is .*; expected one of neo-hookean"),
        (lambda f: edited(f, ("belief", "parts"), ["other"]), "has no other.youngs_modulus"),
        (
            lambda f: edited(f, ("belief", "terms", 0, "settings"), {"place": "here"}),
            "is .*; expected an",
        ),
        (
            lambda f: edited(f, ("belief", "terms", 0, "name"), "magic"),
            "not known here; expected --plug",
        ),
        (lambda f: (f / "pictures").symlink_to("/"), "pictures: is a link that leads out of the run"),
        (lambda f: (f / "numbers.safetensors").write_bytes(b"x"), "numbers.safetensors: cannot be read"),
    ],
)
def test_damaged_runs_are_refused_in_one_line(spoil, words: str, fitted: dict, tmp_path: Path) -> None:
    for name in ("run.json", "numbers.safetensors"):
        (tmp_path / name).write_bytes((Path(fitted["run"]) / name).read_bytes())
    load_run(tmp_path)
    spoil(tmp_path)
    with pytest.raises(ValueError, match=words) as caught:
        load_run(tmp_path)
    assert "\n" not in str(caught.value)
