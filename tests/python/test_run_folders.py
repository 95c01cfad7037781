"""What commands write to: nothing of anybody's is lost, nothing that a run names is run, one at a time."""

import json
import multiprocessing
import os
import shlex
import shutil
import time
from pathlib import Path

import numpy as np
import pytest

from command_example import SPACING, answer, call, make_capture
from mphygs.capture.folder_mark import MARK, is_marked
from mphygs.capture.format import load_capture
from mphygs.capture.written import replace_arrays, replace_file
from mphygs.commands import command as frame
from mphygs.commands import compare, fit, fit_begun, in_use, predict, report, synth
from mphygs.commands.claim import claim, claim_capture, claim_file, claim_output, clear, is_own_file
from mphygs.commands.in_use import HeldError, held, hold
from mphygs.commands.options import CommonOptions, OptionError
from mphygs.fit.run import folder_name, load_run
from mphygs.model import registry

EFFECT = '''
from pathlib import Path
from mphygs.model.registry import ParameterSpec
from mphygs.model.user_effect import register_effect

Path(__file__).with_name("ran").write_text("ran")


@register_effect
class Sideways:
    """A steady push along y."""

    name = "sideways"
    parameters = (ParameterSpec("a", "m/s^2", 0.0, -50.0, 50.0, 1.0),)

    def force(self, state, parameters):
        return state.mass[:, None] * parameters["a"] * state.position.new_tensor([0.0, 1.0, 0.0])
'''


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_capture(tmp_path_factory.mktemp("capture"))


@pytest.fixture(scope="module")
def elastic(capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("runs") / "elastic"
    answer(fit.main, capture, "--out", out, "--spacing", SPACING, "--workers", 1)
    return out


@pytest.fixture
def known_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    """Effects that a test registers are forgotten after it."""
    monkeypatch.setattr(registry, "_USER", {})


def one_line(err: str) -> str:
    assert err.count("\n") == 1 and "Traceback" not in err
    return err


# ---- a run is data ----------------------------------------------------------------------------
def foreign(elastic: Path, folder: Path) -> tuple[Path, Path]:
    """A run that anybody may have made, of an effect that its own plugin registers; and the plugin."""
    shutil.copytree(elastic, folder)
    plugin = folder / "effect.py"
    plugin.write_text(EFFECT)
    document = json.loads((folder / "run.json").read_text())
    document["options"]["plugin"] = str(plugin)
    for key in ("start", "belief"):
        document[key]["terms"] = [{"name": "sideways", "settings": {}}]
        document[key]["parameters"].append(
            {"key": "sideways.a", "value": 0.0, "unit": "m/s^2", "log": False, "free": False,
             "prior_mean": 0.0, "scale": 1.0}
        )  # fmt: skip
    numbers = {k: v for k, v in load_numbers(folder).items()}
    numbers["values"] = np.append(numbers["values"], 0.0)
    save_numbers(folder, numbers)
    (folder / "run.json").write_text(json.dumps(document))
    return folder, plugin


def load_numbers(folder: Path) -> dict[str, np.ndarray]:
    from safetensors.numpy import load_file

    return load_file(folder / "numbers.safetensors")


def save_numbers(folder: Path, numbers: dict[str, np.ndarray]) -> None:
    from safetensors.numpy import save_file

    save_file(numbers, folder / "numbers.safetensors")


@pytest.mark.parametrize("main", [compare.main, predict.main, report.main])
def test_what_a_run_names_is_run_only_when_it_is_named_again(
    main, elastic: Path, tmp_path: Path, known_effects: None
) -> None:
    run, plugin = foreign(elastic, tmp_path / "run")
    code, out, err = call(main, run)
    assert (code, out) == (2, "")
    line = one_line(err)
    assert 'the effect "sideways" is not known here; expected --plugin FILE' in line and str(plugin) in line
    assert not (run / "ran").exists()
    code, _, err = call(main, run, "--plugin", plugin, "--workers", 1)
    assert code == 0, err
    assert (run / "ran").exists()


def test_an_effect_that_nobody_knows_is_refused(elastic: Path, tmp_path: Path) -> None:
    run, plugin = foreign(elastic, tmp_path / "run")
    plugin.unlink()
    code, _, err = call(compare.main, run, "--plugin", plugin)
    assert code == 2 and "no such file" in one_line(err)


def test_a_stopped_command_goes_on_with_its_plugin(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, known_effects: None
) -> None:
    plugin = tmp_path / "effect.py"
    plugin.write_text(EFFECT)

    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(fit, "fit_run", stop)
    options = ("--out", tmp_path / "run", "--spacing", SPACING)
    code, _, err = call(fit.main, capture, *options, "--plugin", plugin, "--effects", "sideways")
    assert code == 130
    assert err.splitlines()[-1].endswith(f"--resume --plugin {shlex.quote(str(plugin))}")


def test_the_default_folder_of_a_run_stays_among_the_runs(
    capture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    work = tmp_path / "deep" / "work"
    work.mkdir(parents=True)
    monkeypatch.chdir(work)
    for name in ("../../outside", str(tmp_path / "outside"), ".hidden", "..", "a" * 180, "Jim's bar: two/2"):
        shutil.copytree(capture, work / "capture", dirs_exist_ok=True)
        document = json.loads((capture / "capture.json").read_text()) | {"name": name}
        (work / "capture" / "capture.json").write_text(json.dumps(document))
        code, _, _ = call(fit.main, "capture", "--spacing", SPACING, "--frames", "bad")
        assert code == 2
        where = fit_begun._default_folder(fit.FitOptions(capture=work / "capture"))
        assert where.parent == Path("runs") and where.name == folder_name(name)
        assert where.resolve().parent == (work / "runs").resolve()
        assert len(where.name.encode()) <= 100 and not where.name.startswith(".")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["deep"]


@pytest.mark.parametrize("name", ["a\x1b[31mred", "a\nb", "x" * 5000, "\u202egnp.txt", " "])
def test_names_that_do_not_print_are_refused_and_not_shown(name: str, capture: Path, tmp_path: Path) -> None:
    shutil.copytree(capture, tmp_path / "capture")
    for keys in (("name",), ("sequences", 0, "name"), ("object", "parts", 0, "name")):
        document = json.loads((capture / "capture.json").read_text())
        inner = document
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = name
        (tmp_path / "capture" / "capture.json").write_text(json.dumps(document))
        code, _, err = call(fit.main, tmp_path / "capture", "--out", tmp_path / "run")
        line = one_line(err)
        assert code == 2 and "name" in line and line.strip().isprintable() and len(line) < 2000
        assert not (tmp_path / "run").exists()


# ---- nothing is lost --------------------------------------------------------------------------
def mine(folder: Path, *files: str) -> dict[str, bytes]:
    """A folder with files of a user's; what is in it."""
    for name in files:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("precious")
    return contents(folder)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize(
    "files",
    [
        ("report.html", "stages/note.txt"),
        ("steps.json", "stages/note.txt"),
        ("comparison.json", "first-fit/note.txt"),
        ("diagnosis.json", "capture/answer.json"),
        ("run.json",),
        ("steps.json",),
        ("notes.txt", "pictures/a.png"),
    ],
)
def test_a_folder_of_somebody_else_is_refused(files: tuple[str, ...], tmp_path: Path) -> None:
    before = mine(tmp_path / "mine", *files)
    with pytest.raises(OptionError, match="expected a run folder, or a new one"):
        claim(tmp_path / "mine", inner_runs=("first-fit",), alone="steps.json")
    for function in (claim_capture, claim_output):
        with pytest.raises(OptionError, match="expected a new folder"):
            function(tmp_path / "mine")
    assert contents(tmp_path / "mine") == before


@pytest.mark.parametrize(
    "name", ["report.html", "steps.json", "comparison.json", "diagnosis.json", "missing_force.py",
             "missing-force.safetensors", "diagnosis-so-far.json"],
)  # fmt: skip
def test_a_file_of_ones_own_in_a_run_is_not_replaced(name: str, elastic: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(elastic, run)
    for content in ("precious", '{"mine": 1}', "<!doctype html><title>mine"):
        (run / name).write_text(content)
        before = contents(run)
        with pytest.raises(OptionError, match=f"{name}: was not made here"):
            claim(run)
        assert contents(run) == before


def test_files_of_other_names_stay_in_a_run_that_is_fitted_again(
    elastic: Path, capture: Path, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    shutil.copytree(elastic, run)
    before = mine(run, "notes.txt", "pictures/holiday.png", "data/table.csv")
    (run / "comparison.json").write_text(
        json.dumps({"sequences": {}, "adequate": True, "pictures": ["/x/table.csv", "../notes.txt"]})
    )
    answer(fit.main, capture, "--out", run, "--spacing", SPACING, "--workers", 1)
    after = contents(run)
    assert not (run / "comparison.json").exists()
    for name in ("notes.txt", "pictures/holiday.png", "data/table.csv"):
        assert after[name] == before[name]


def test_stages_of_ones_own_make_a_folder_to_work_in(tmp_path: Path) -> None:
    mine(tmp_path / "run", "stages/rest/gaussians.ply")
    with held():
        claim(tmp_path / "run")
        assert is_marked(tmp_path / "run")
    assert (tmp_path / "run" / "stages" / "rest" / "gaussians.ply").read_text() == "precious"


def test_a_run_may_stand_inside_the_folder_of_its_stages(tmp_path: Path) -> None:
    with held():
        claim(tmp_path / "daisy" / "full")
        (tmp_path / "daisy" / "full" / "run.json").write_text("{}")
        claim(tmp_path / "daisy")
    mine(tmp_path / "other", "full/notes.txt")
    with pytest.raises(OptionError, match="expected a run folder"):
        claim(tmp_path / "other")


def test_outputs_go_to_new_folders_or_to_those_of_before(elastic: Path, tmp_path: Path) -> None:
    mine(tmp_path / "mine", "swing.npz", "swing.png")
    for main in (predict.main, compare.main):
        code, _, err = call(main, elastic, "--out", tmp_path / "mine")
        assert code == 2 and "expected a new folder" in one_line(err)
    for _ in range(2):
        assert answer(predict.main, elastic, "--out", tmp_path / "new", "--sequences", "swing")
    assert set(contents(tmp_path / "new")) == {MARK, "swing.npz"}


def test_a_report_takes_no_place_of_another_file(elastic: Path, tmp_path: Path) -> None:
    mine(tmp_path, "index.html")
    code, _, err = call(report.main, elastic, "--out", tmp_path / "index.html")
    assert code == 2 and "was not made here" in one_line(err)
    assert (tmp_path / "index.html").read_text() == "precious"
    (tmp_path / "old.html").write_text("<!doctype html>\n<title>mphygs: tiny</title>")
    claim_file(tmp_path / "old.html")


def test_a_capture_is_made_over_no_other_one(capture: Path, tmp_path: Path) -> None:
    folder = tmp_path / "capture"
    shutil.copytree(capture, folder)
    (folder / "answer.json").write_text('{"mine": true}')
    before = contents(folder)
    code, _, err = call(synth.main, "bar", "--out", folder, "--frames", 8)
    assert code == 2 and "expected a new folder" in one_line(err)
    assert contents(folder) == before


def test_links_are_replaced_and_not_followed(tmp_path: Path) -> None:
    (tmp_path / "target").write_text("precious")
    (tmp_path / "link.json").symlink_to(tmp_path / "target")
    replace_file(tmp_path / "link.json", "new")
    assert (tmp_path / "target").read_text() == "precious" and not (tmp_path / "link.json").is_symlink()
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / MARK).symlink_to(tmp_path / "target")
    with pytest.raises(OSError):
        hold(tmp_path / "run")
    assert (tmp_path / "target").read_text() == "precious"


def test_pictures_that_lead_elsewhere_are_not_written(elastic: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(elastic, run)
    (tmp_path / "elsewhere").mkdir()
    (run / "pictures").symlink_to(tmp_path / "elsewhere")
    code, _, err = call(compare.main, run)
    assert code == 2 and "leads out of the run" in one_line(err)
    assert not any((tmp_path / "elsewhere").iterdir())


# ---- one at a time ----------------------------------------------------------------------------
def holding(folder: Path, ready) -> None:  # noqa: ANN001 (an event of another process)
    with held():
        hold(folder)
        ready.set()
        time.sleep(120)


@pytest.fixture
def another(tmp_path: Path):  # noqa: ANN201
    """Another process that holds the folder `run` while the test runs."""
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    process = context.Process(target=holding, args=(tmp_path / "run", ready))
    process.start()
    assert ready.wait(60)
    yield process
    process.kill()
    process.join(60)


def test_a_folder_is_one_commands_at_a_time(another, capture: Path, tmp_path: Path) -> None:
    code, _, err = call(fit.main, capture, "--out", tmp_path / "run", "--spacing", SPACING)
    assert code == 2 and f"process {another.pid} on" in one_line(err)
    with pytest.raises(HeldError, match=f"process {another.pid}"):
        claim_output(tmp_path / "run")
    assert set(contents(tmp_path / "run")) == {MARK}


def test_a_holder_that_was_killed_holds_nothing(another, tmp_path: Path) -> None:
    another.kill()
    another.join(60)
    with held():
        claim(tmp_path / "run")
        assert json.loads((tmp_path / "run" / MARK).read_text())["pid"] == os.getpid()


def test_folders_in_which_nothing_was_written_go(tmp_path: Path) -> None:
    with held():
        claim(tmp_path / "a" / "b" / "run")
        claim(tmp_path / "kept")
        with held():
            claim(tmp_path / "kept")
        (tmp_path / "kept" / "run.json").write_text("{}")
        assert json.loads((tmp_path / "kept" / MARK).read_text())["pid"] == os.getpid()
    assert [p.name for p in tmp_path.iterdir()] == ["kept"]
    assert "pid" not in json.loads((tmp_path / "kept" / MARK).read_text()) and not in_use._HELD


def write_often(path: Path, count: int) -> None:
    for number in range(count):
        replace_file(path, json.dumps({"number": number, "text": "x" * 10_000}))
        json.loads(path.read_text())


def test_writers_of_one_file_do_not_meet(tmp_path: Path) -> None:
    context = multiprocessing.get_context("spawn")
    pair = [context.Process(target=write_often, args=(tmp_path / "one.json", 300)) for _ in range(2)]
    for process in pair:
        process.start()
    for process in pair:
        process.join(120)
    assert [process.exitcode for process in pair] == [0, 0]
    assert [p.name for p in tmp_path.iterdir()] == ["one.json"]


# ---- places that cannot be written to ---------------------------------------------------------
def test_a_full_disk_leaves_the_old_file_and_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.json"
    path.write_text("old")

    def full(_descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    for write in (lambda: replace_file(path, "new"), lambda: replace_arrays(path, {"a": np.zeros(3)})):
        with pytest.raises(OSError) as caught:
            write()
        assert (caught.value.errno, caught.value.filename) == (28, str(path))
    assert contents(tmp_path) == {"run.json": b"old"}


@pytest.mark.parametrize(
    ("number", "code"), [(28, 1), (5, 1), (13, 2), (30, 2), (36, 2), (20, 2), (21, 2), (122, 1)]
)
def test_what_the_system_says_of_a_place_is_one_line(number: int, code: int, tmp_path: Path) -> None:
    def action(*_: object) -> None:
        raise OSError(number, os.strerror(number), str(tmp_path / "place"))

    found, _, err = call(lambda argv: frame.run(CommonOptions, action, program="x", argv=argv))
    assert found == code
    assert (
        one_line(err)
        == f"x: {tmp_path / 'place'}: {os.strerror(number)}; expected a place to read and write\n"
    )


@pytest.mark.parametrize("name", ["n" * 300, "/".join(["deep" * 20] * 80), "file/run", "a\x1b[2Jb" * 60])
def test_paths_that_cannot_be_are_told_in_one_line(name: str, capture: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    for main in (fit.main, synth.main):
        source = ("bar", "--frames", 8) if main is synth.main else (capture, "--spacing", SPACING)
        code, _, err = call(main, *source, "--out", f"{tmp_path}/{name}")
        line = one_line(err)
        assert code == 2 and line.strip().isprintable() and len(line) < 2000 and str(tmp_path) in line
    assert contents(tmp_path) == {"file": b"mine"}


def test_a_run_that_is_written_is_known_again(elastic: Path, tmp_path: Path) -> None:
    assert is_own_file(elastic / "run.json") and is_marked(elastic)
    assert load_run(elastic).complete and load_capture(load_run(elastic).capture)
    run = tmp_path / "run"
    shutil.copytree(elastic, run)
    (run / MARK).unlink()
    with held():
        claim(run)
        clear(run)
    assert load_run(run).complete
