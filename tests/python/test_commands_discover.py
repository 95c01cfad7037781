"""The commands that say what is missing: extend, diagnose, discover."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from command_example import ETA, SPACING, answer, call, make_capture
from mphygs.commands import command as frame
from mphygs.commands import compare, diagnose, discover, extend, fit, predict
from mphygs.diagnose.missing_force_document import Unexplained, keep_missing_force, with_plugin_in
from mphygs.extend import loop_record as kept_steps
from mphygs.fit.run import load_run

CANDIDATES = "viscosity,gravity"
# Names that what the capture holds does not bear.
WRONG = "eigenstrain,length_scale"


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("capture"))


@pytest.fixture(scope="module")
def elastic(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "elastic"
    answer(fit.main, capture, "--out", out, "--spacing", SPACING)
    return out


@pytest.fixture(scope="module")
def extended(elastic: Path) -> dict:
    """The extension of the elastic run, where one goes by itself."""
    return answer(extend.main, elastic, "viscosity")


@pytest.fixture(scope="module")
def diagnosed(elastic: Path) -> dict:
    """The diagnosis of the elastic run, by one that is not stopped."""
    return answer(diagnose.main, elastic, "--effects", CANDIDATES)


@pytest.fixture(scope="module")
def discovered(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """The loop that is not stopped."""
    out = tmp_path_factory.mktemp("loops") / "again"
    options = ("--out", out, "--spacing", SPACING, "--effects", CANDIDATES)
    return out, answer(discover.main, capture, *options)


def test_extend_shows_the_error_before_and_after(elastic: Path, extended: dict) -> None:
    found = extended
    assert found["run"] == f"{elastic}-viscosity"
    before, after = found["steps"]
    assert (before["effects"], after["effects"], after["added"]) == ([], ["viscosity"], ["viscosity"])
    for label in ("fit", "predict"):
        assert after["sequences"]["swing"][label]["rms"] < 0.8 * before["sequences"]["swing"][label]["rms"]
    eta = after["parameters"]["viscosity.eta"]
    assert abs(eta["value"] - ETA) < 3 * eta["std"]
    assert after["pays"] is True
    assert (found["verdict"], found["effects"]) == ("missing", ["viscosity"])
    run = load_run(found["run"])
    assert run.complete and run.belief["viscosity.eta"].value == eta["value"]
    options = ("--effects", "viscosity", "--spacing", SPACING)
    fitted = answer(fit.main, run.capture, "--out", elastic / "again", *options)["parameters"]
    assert abs(eta["value"] - fitted["viscosity.eta"]["value"]) < 0.5 * eta["std"]


def test_extend_says_when_an_effect_does_not_pay(extended: dict, tmp_path: Path) -> None:
    viscous = extended["run"]
    found = answer(extend.main, viscous, "eigenstrain", "--out", tmp_path / "more")
    assert found["steps"][1]["pays"] is False
    assert found["effects"] == []
    code, out, _ = call(extend.main, viscous, "eigenstrain", "--out", tmp_path / "more")
    assert code == 0 and "eigenstrain does not pay on unseen frames" in out


@pytest.mark.parametrize(
    ("adequate", "paying", "explained", "verdict"),
    [
        (True, [], True, "adequate"),
        # Once an effect was added, also to a model that was at the floor, it is missing in that.
        (True, ["viscosity"], True, "missing"),
        (False, ["viscosity", "time_offset"], True, "missing"),
        (False, ["time_offset"], True, "measurement"),
        (False, ["viscosity"], False, "unknown"),
    ],
)
def test_the_verdict_of_an_extension(
    adequate: bool, paying: list[str], explained: bool, verdict: str
) -> None:
    assert extend.verdict_of(adequate, paying, explained) == verdict


@pytest.mark.parametrize("text", ["[1]", '{"steps": [{}]}', '{"steps": 3}', "\x00"])
def test_steps_that_are_damaged_are_refused(text: str, elastic: Path, tmp_path: Path) -> None:
    (tmp_path / "steps.json").write_text(text)
    code, out, err = call(extend.main, elastic, "viscosity", "--out", tmp_path, "--resume")
    assert (code, out) == (2, "") and "steps.json: " in err and err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["magic"], "unknown effect 'magic'"),
        ([], "no effect named"),
        (["viscosity", "viscosity"], "is in the model already"),
    ],
)
def test_extend_refuses_in_one_line(elastic: Path, tmp_path: Path, arguments: list[str], words: str) -> None:
    code, out, err = call(extend.main, elastic, *arguments, "--out", tmp_path / "run")
    assert (code, out) == (2, "")
    assert words in err.splitlines()[-1]
    assert not (tmp_path / "run").exists()


def test_diagnose_names_what_is_missing(elastic: Path, diagnosed: dict) -> None:
    found = diagnosed
    assert set(found) == {
        "verdict", "effects", "ranking", "missing_force", "drift", "advice", "table", "path",
    }  # fmt: skip
    assert (found["verdict"], found["effects"]) == ("missing", ["viscosity"])
    first, second = found["ranking"]
    assert (first["effect"], first["kind"], second["effect"]) == ("viscosity", "smooth", "gravity")
    assert first["statistic"] > 2 * second["statistic"]
    assert first["p_value"] < 1e-6
    assert 0.5 * ETA < first["estimate"]["eta"] < 2 * ETA
    assert set(first) >= {"expected_rms", "confounded_with"}
    row, other = found["table"]
    assert (row["effect"], row["struck"], row["numbers"]) == ("viscosity", None, 1)
    assert row["predicted_drop"] == first["statistic"] and row["drop"] == first["refitted"]
    assert row["gain"] > 2 * row["gain_se"] > 0.0
    assert abs(row["estimate"]["eta"] - ETA) < 4 * row["std"]["eta"]
    assert other["effect"] == "gravity" and other["struck"]
    before_, after_ = found["path"]
    assert (before_["model"], after_["model"]) == ([], ["viscosity"])
    assert 0.9 < after_["fitted"] < 1.1 and after_["unseen_fall"] == pytest.approx(
        1.0 - after_["unseen"] / before_["unseen"]
    )
    assert not before_["adequate"] and before_["p_value"] < 0.01
    assert after_["adequate"] and (after_["p_value"] >= 0.01 or after_["fitted"] < 1.1)
    assert "viscosity" in found["advice"]
    assert json.loads((elastic / "diagnosis.json").read_text()) == found


@pytest.mark.parametrize("kept", [1, 2])
def test_diagnose_goes_on_where_it_was_stopped(
    kept: int, elastic: Path, diagnosed: dict, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """kept: the number of steps that it had found."""
    run = tmp_path / "a run"
    shutil.copytree(elastic, run)
    before = (run / "run.json").read_bytes()
    write = diagnose.write_record

    def broken_off(path: Path, document: dict) -> None:
        write(path, document)
        if len(document["steps"]) == kept:
            raise KeyboardInterrupt

    monkeypatch.setattr(diagnose, "write_record", broken_off)
    code, out, err = call(diagnose.main, run, "--effects", CANDIDATES)
    assert (code, out) == (130, "")
    monkeypatch.undo()
    if kept > 1:
        line = f"continue with: mphygs diagnose '{run}' --effects {CANDIDATES} --resume"
        assert line in err.splitlines()[-1]
        # The first ranking is not made again.
        monkeypatch.setattr("mphygs.extend.window_ranking.rank", None)
    code, _, err = call(diagnose.main, run, "--effects", "gravity", "--resume")
    assert code == 2 and f"began with {CANDIDATES}" in err and err.count("\n") == 1
    found = answer(diagnose.main, run, "--effects", CANDIDATES, "--resume")
    monkeypatch.undo()
    assert found == diagnosed
    assert (run / "run.json").read_bytes() == before
    code, _, err = call(diagnose.main, run, "--effects", CANDIDATES, "--resume")
    assert code == 2 and "no diagnosis that was stopped" in err


def test_a_fit_takes_away_what_a_diagnosis_had_found(capture: Path, elastic: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    fitted = (fit.main, capture, "--out", out, "--spacing", SPACING)
    shutil.copytree(elastic, out)
    (out / diagnose.SO_FAR).write_text('{"steps": [], "states": []}')
    answer(*fitted)
    assert not (out / diagnose.SO_FAR).exists()


def test_extend_goes_on_where_it_was_stopped(
    elastic: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "two effects"
    add = extend.add_effect

    def broken_off(*arguments: object, **options: object) -> tuple:
        if arguments[2] == "gravity":
            raise KeyboardInterrupt
        return add(*arguments, **options)

    monkeypatch.setattr(extend, "add_effect", broken_off)
    options = (elastic, "viscosity,gravity", "--out", out)
    code, text, err = call(extend.main, *options)
    assert (code, text) == (130, "")
    again = f"mphygs extend {elastic} viscosity gravity --out '{out}' --resume"
    assert f"continue with: {again}" in err.splitlines()[-1]
    monkeypatch.undo()

    def only_the_second(*arguments: object, **options: object) -> tuple:
        assert arguments[2] == "gravity"
        return add(*arguments, **options)

    monkeypatch.setattr(extend, "add_effect", only_the_second)
    code, _, err = call(extend.main, elastic, "viscosity", "--out", out, "--resume")
    assert code == 2 and "was to add viscosity, gravity" in err and err.count("\n") == 1
    found = answer(extend.main, *options, "--resume")
    assert answer(extend.main, *options, "--resume") == found
    monkeypatch.undo()
    # What was stopped is no obstacle to a new one in its place.
    (out / "run.json").unlink()
    (out / "numbers.safetensors").unlink(missing_ok=True)
    whole = answer(extend.main, *options)
    assert found == whole
    code, _, err = call(extend.main, elastic, "viscosity", "--out", tmp_path / "other", "--resume")
    assert code == 2 and "holds no step of mphygs extend" in err


def test_diagnose_finds_the_force_where_no_name_explains(elastic: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(elastic, run)
    found = answer(diagnose.main, run, "--effects", WRONG)
    assert (found["verdict"], found["effects"]) == ("unknown", [])
    force = found["missing_force"]
    assert set(force) >= {"rms", "direction", "where", "when", "formula"}
    assert force["sigma"]["with"] < 1.05 < 1.3 < force["sigma"]["without"]
    assert force["where"][0]["part"] == "bar" and force["when"][0]["sequence"] == "swing"
    assert force["nature"] == ["dissipative"]
    assert (run / "missing-force.safetensors").is_file()


def test_discover_ends_unknown_with_the_force(capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "loop"
    options = ("--out", out, "--spacing", SPACING, "--effects", WRONG)
    found = answer(discover.main, capture, *options)
    assert found["verdict"] == "unknown" and found["missing_force"]["rms"] > 0.0
    kept = json.loads((out / "diagnosis.json").read_text())
    assert kept["missing_force"] == found["missing_force"]
    assert (out / "missing-force.safetensors").is_file()
    assert answer(discover.main, capture, *options, "--resume") == found


def test_diagnose_leaves_a_complete_model_alone(extended: dict) -> None:
    viscous = extended["run"]
    code, out, err = call(diagnose.main, viscous, "--effects", "gravity,viscosity")
    assert (code, out) == (2, "") and "'viscosity' is in the model already" in err
    found = answer(diagnose.main, viscous, "--effects", "gravity,mass_damping")
    assert (found["verdict"], found["effects"]) == ("adequate", [])
    assert {e["effect"] for e in found["ranking"]} == {"gravity", "mass_damping"}
    for entry in found["ranking"]:
        assert entry["p_value"] > 0.01
        # Of one parameter (z of the test + z of the power) standard errors, of several a little more.
        sizes = [entry["detectable"][name] / std for name, std in entry["std"].items()]
        assert min(sizes) > 3.0 and max(sizes) < 6.0
    code, out, _ = call(diagnose.main, viscous, "--effects", "gravity,mass_damping")
    alpha = next(e for e in found["ranking"] if e["effect"] == "mass_damping")["detectable"]["alpha"]
    assert code == 0 and f"  mass_damping: alpha {alpha:.3g} 1/s" in out.splitlines()


@pytest.mark.parametrize("kept", [False, True])
def test_discover_runs_the_loop_and_resumes(
    kept: bool,
    capture: Path,
    discovered: tuple[Path, dict],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """kept: whether it is stopped right after the step with the effect was kept, or right before."""
    options = ("--out", tmp_path / "loop", "--spacing", SPACING, "--effects", CANDIDATES)
    whole = kept_steps.step_document

    def broken_off(step: object, *arguments: object) -> dict:
        if step.added:
            raise KeyboardInterrupt
        return whole(step, *arguments)

    def silent(_steps: object) -> list[str]:
        raise KeyboardInterrupt

    patch = (discover, "steps_text", silent) if kept else (kept_steps, "step_document", broken_off)
    monkeypatch.setattr(*patch)
    code, out, err = call(discover.main, capture, *options)
    assert (code, out) == (130, "")
    last = err.splitlines()[-1]
    assert "--resume" in last and f"--effects {CANDIDATES}" in last and f"--spacing {SPACING}" in last
    monkeypatch.undo()
    assert len(json.loads((tmp_path / "loop" / "steps.json").read_text())["steps"]) == 1 + kept
    found = answer(discover.main, capture, *options, "--resume")
    other, again = discovered
    assert [s["effects"] for s in found["steps"]] == [[], ["viscosity"]]
    assert (found["verdict"], found["effects"]) == ("missing", ["viscosity"])
    assert found["steps"] == again["steps"]
    done = answer(discover.main, capture, *options, "--resume")
    assert done == found
    steps = tmp_path / "loop" / "steps.json"
    steps.write_text(json.dumps({k: v for k, v in json.loads(steps.read_text()).items() if k != "verdict"}))
    with pytest.MonkeyPatch.context() as patch:
        asked = []
        patch.setattr(discover, "discover_effects", lambda *_, names, **__: asked.append(names) or 1 / 0)
        call(discover.main, capture, *options[:4], "--resume")
    assert asked == [tuple(CANDIDATES.split(","))]
    code, _, err = call(discover.main, capture, *options[:4], "--effects", "gravity", "--resume")
    assert code == 2 and f"began with {CANDIDATES}" in err
    run = load_run(found["run"])
    assert run.complete and run.belief.effects == ("viscosity",)
    diagnoses = [json.loads((folder / "diagnosis.json").read_text()) for folder in (tmp_path / "loop", other)]
    assert diagnoses[0]["effects"] == ["viscosity"]
    assert diagnoses[0] == diagnoses[1]


def test_discover_refuses_in_one_line(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = tmp_path / "own.py"
    monkeypatch.setattr(frame, "load_plugin", lambda _path: ("own",))
    for arguments, words in (
        (["--effects", "magic"], "unknown effect 'magic'"),
        (["--effects", "prestress"], "prestress is not scored"),
        (["--plugin", plugin, "--effects", "magic"], "unknown effect 'magic'"),
        (["--plugin", plugin, "--effects", "prestress"], "prestress is not scored"),
        (["--resume"], "holds no loop"),
    ):
        code, out, err = call(discover.main, capture, "--out", tmp_path / "loop", *arguments)
        assert (code, out) == (2, "")
        assert words in err and err.count("\n") == 1


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.mark.parametrize(
    "arguments",
    [
        (discover.main, "NOWHERE"),
        (discover.main, "CAPTURE", "--frames", "bad"),
        (discover.main, "CAPTURE", "--sequences", "nobody"),
        (discover.main, "CAPTURE", "--spacing", "-1"),
        (fit.main, "CAPTURE", "--frames", "bad"),
        (fit.main, "CAPTURE", "--sequences", "nobody"),
        # No cell of this grid holds the bar's material.
        (discover.main, "CAPTURE", "--spacing", "10"),
        (discover.main, "CAPTURE", "--spacing", "10", "--transfer", "mls"),
        (fit.main, "CAPTURE", "--spacing", "10"),
        (fit.main, "CAPTURE", "--spacing", "inf"),
    ],
)
def test_what_is_at_fault_takes_nothing_away(
    arguments: tuple, elastic: Path, capture: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    shutil.copytree(elastic, out)
    for name in ("steps.json", "diagnosis.json", "comparison.json", "report.html", "missing_force.py"):
        (out / name).write_text("{}")
    before = snapshot(out)
    command, *words = arguments
    words = [{"CAPTURE": capture, "NOWHERE": tmp_path / "nowhere"}.get(word, word) for word in words]
    code, _, err = call(command, *words, "--out", out)
    assert code == 2 and err.count("\n") == 1
    assert snapshot(out) == before


def test_a_fit_leaves_the_plugin_that_it_uses(
    elastic: Path, capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The effect that a diagnosis has written is used from where it is, for a fit to the same folder."""
    out = tmp_path / "run"
    shutil.copytree(elastic, out)
    plugin = out / "missing_force.py"
    plugin.write_text("mine")
    monkeypatch.setattr(frame, "load_plugin", lambda _path: ("own",))
    answer(fit.main, capture, "--out", out, "--spacing", SPACING, "--plugin", plugin)
    assert plugin.read_text() == "mine" and load_run(out).options["plugin"] == str(plugin.resolve())
    # Nor does a diagnosis of that run write over it, or take it away.
    explained = SimpleNamespace(formula=None, features=())
    found = Unexplained(None, (), explained, (), in_plugin=True)
    assert with_plugin_in(found, out, plugin).in_plugin is False
    assert with_plugin_in(found, tmp_path, plugin) is found and with_plugin_in(None, out, plugin) is None
    with_plugin_in(found, out, plugin).save(out)
    keep_missing_force(None, out, str(plugin))
    assert plugin.read_text() == "mine" and not (out / "missing-force.safetensors").exists()
    keep_missing_force(None, out)
    assert not plugin.exists()


def test_only_pictures_of_the_run_before_are_taken_away(elastic: Path, capture: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    shutil.copytree(elastic, out)
    drawn = [Path(path) for path in answer(compare.main, out)["pictures"]]
    (out / "pictures" / "mine.png").write_text("mine")
    assert drawn and all(path.is_file() and path.parent == out / "pictures" for path in drawn)
    answer(fit.main, capture, "--out", out, "--spacing", SPACING)
    assert [path.name for path in (out / "pictures").iterdir()] == ["mine.png"]
    assert not (out / "comparison.json").exists()


def test_no_run_is_written_over_what_is_none(elastic: Path, capture: Path, tmp_path: Path) -> None:
    own = tmp_path / "own"
    own.mkdir()
    (own / "run.json").write_text('{"mine": 1}')
    copy = tmp_path / "copy"
    shutil.copytree(capture, copy)
    for out, folder in ((own, own), (copy, copy), (own / "run.json" / "x", own)):
        before = snapshot(folder)
        commands = ((discover.main, capture), (extend.main, elastic, "gravity"), (fit.main, capture))
        for command, *words in commands:
            code, _, err = call(command, *words, "--out", out)
            assert code == 2 and "--out" in err and err.count("\n") == 1
        assert snapshot(folder) == before


# What commands find stands in a run's folder under these names.
FOUND = {
    "diagnosis.json": '{"verdict": "adequate", "ranking": []}',
    "comparison.json": '{"sequences": {}, "adequate": true}',
    "report.html": "<!doctype html><title>mphygs: run</title>",
}


def test_extend_takes_away_what_was_found_with_an_older_run(elastic: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    shutil.copytree(elastic, out)
    for name in ("diagnosis.json", "comparison.json", "report.html"):
        (out / name).write_text(FOUND[name])
    answer(extend.main, elastic, "gravity", "--out", out)
    assert not any((out / name).exists() for name in ("diagnosis.json", "comparison.json", "report.html"))
    assert load_run(out).belief.effects == ("gravity",)


@pytest.mark.parametrize("command", [compare.main, predict.main])
def test_a_place_that_cannot_be_written_to_is_named(command: object, elastic: Path, tmp_path: Path) -> None:
    place = tmp_path / "file"
    place.write_text("mine")
    code, _, err = call(command, elastic, "--out", place)
    last = err.splitlines()[-1]
    assert code == 2 and f"{place}: is a file; expected a folder" in last
    assert place.read_text() == "mine"


def test_compare_tells_how_much_is_done(elastic: Path, tmp_path: Path) -> None:
    code, _, err = call(compare.main, elastic, "--out", tmp_path)
    lines = [line for line in err.splitlines() if "] predicting " in line]
    assert code == 0 and lines[0].startswith("[  0 %,")
    shares = [int(line[1:4]) for line in lines]
    assert shares == [100 * k // len(lines) for k in range(len(lines))]


def test_what_a_run_leaves_out_is_an_effect_of_what_it_is_extended_from(
    elastic: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    shutil.copytree(elastic, run)
    document = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps(document | {"left_out": {"swing": [[2, 0]]}}))
    found = answer(extend.main, run, "gravity", "--out", tmp_path / "more")
    before, after = (step["effects"] for step in found["steps"])
    assert (before, after) == (["marker_outliers"], ["marker_outliers", "gravity"])
