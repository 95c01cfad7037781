"""`mphygs batch` as a whole: what it refuses, runs, keeps, and goes on with."""

import contextlib
import csv
import importlib.util
import json
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from safetensors.numpy import load_file

from command_example import SPACING, answer, call, make_capture
from mphygs.batch import cluster
from mphygs.batch.work import Outcome, Task
from mphygs.capture.folder_mark import is_marked
from mphygs.commands import batch as command
from mphygs.commands import fit
from mphygs.commands.command_table import main as mphygs
from mphygs.commands.in_use import held, hold
from mphygs.fit.run import load_run
from mphygs.model import registry

OPTIONS = ("--spacing", SPACING)
EFFECT = """
from pathlib import Path
from mphygs.model.registry import ParameterSpec
from mphygs.model.user_effect import register_effect

Path(__file__).with_name("ran").touch()


@register_effect
class Sideways:
    name = "sideways"
    parameters = (ParameterSpec("a", "m/s^2", 0.0, -50.0, 50.0, 1.0),)

    def force(self, state, parameters):
        return state.mass[:, None] * parameters["a"] * state.position.new_tensor([0.0, 1.0, 0.0])
"""


@pytest.fixture(scope="module")
def captures(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Two captures of one name, and a folder that is none."""
    root = tmp_path_factory.mktemp("captures")
    first = make_capture(root / "one" / "bar")
    second = make_capture(root / "two" / "bar", eta=0.0)
    (root / "empty").mkdir()
    return [first, second, root / "empty"]


@pytest.fixture(scope="module")
def alone(captures: list[Path], tmp_path_factory: pytest.TempPathFactory) -> dict:
    """What a fit of the first says by itself."""
    out = tmp_path_factory.mktemp("runs") / "alone"
    return answer(fit.main, captures[0], "--out", out, "--workers", 1, *OPTIONS)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (["a", "--command", "nothing"], "got 'nothing'; expected one of reconstruct, segment, fit"),
        (["a", "--command", "view"], "--command: got 'view'"),
        (["a", "--command", "batch"], "--command: got 'batch'"),
        (["a"], "--command: not given"),
        (["--command", "fit"], "no folder named"),
        (["a", "./a", "--command", "fit"], "is named twice"),
        (["a", "--command", "fit", "--seeds", "1,x"], "--seeds: got '1,x'"),
        (["a", "--command", "fit", "--seeds", "1,1"], "--seeds: got '1,1'"),
        (["a", "--command", "diagnose", "--seeds", "1"], "diagnose has no seed"),
        (["a", "--command", "compare", "--each-effect", "b"], "compare takes no effects"),
        (["a", "--command", "fit", "--each-effect", "b+"], "--each-effect: got 'b+'; expected names between"),
        (["a", "--command", "fit", "--each-effect", "b+c,c+b"], "expected every choice of effects once"),
        (["a", "--command", "diagnose", "--each-effect", "b,c"], "writes into the folder"),
        (["a", "--command", "fit", "--threads", "0"], "--threads: got 0"),
        (["a", "--command", "fit", "--workers", "0"], "--workers: got 0"),
        (["a", "--command", "fit", "--scheduler", "here"], "--scheduler: got 'here'"),
        (["a", "--command", "fit", "--scheduler", "here:1", "--workers", "2"], "not with --scheduler"),
        (["a", "--command", "fit", "--", "--bogus", "3"], "after --: Unrecognized options: --bogus"),
        (["a", "--command", "fit", "--", "--out", "x"], "after --: got --out"),
        (["a", "--command", "fit", "--", "--workers=3"], "after --: got --workers=3"),
        (["a", "--command", "fit", "--", "--plugin", "x.py"], "after --: got --plugin"),
        (["a", "--command", "fit", "--", "--help"], "after --: got --help"),
        (["a", "--command", "fit", "--seeds", "1", "--", "--seed", "2"], "after --: got --seed"),
        (["--resume"], "--resume: got no --out"),
        (["--resume", "--out", "none"], "none holds no batch"),
    ],
)
def test_what_no_run_could_be_is_refused_in_one_line(
    line: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, out, err = call(command.main, *line)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert words in err
    assert not any(tmp_path.iterdir())


def test_without_dask_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    code, out, err = call(command.main, "a", "--command", "fit", "--out", tmp_path / "out")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "pip install 'mphygs[cluster]'" in err


@dataclass
class Here:
    """One worker that runs every task in this process. stops: after so many runs, Ctrl-C."""

    stops: int | None = None
    ran: list[str] = field(default_factory=list)

    def threads(self) -> dict[str, int]:
        return {"here": 1}

    def wait(self, _seconds: float) -> None:
        pass

    def submit(self, _address: str, one: Task, threads: int) -> "Ended":
        if self.stops == len(self.ran):
            raise KeyboardInterrupt
        self.ran.append(one.name)
        words = [*one.words, "--json", *(["--workers", str(threads)] if one.limited else [])]
        code, out, err = call(mphygs, *words)
        one.log.parent.mkdir(exist_ok=True)
        one.log.write_text(err)
        line = err.splitlines()[-1].removeprefix(f"mphygs {one.words[0]}: ")
        return Ended(Outcome(code, "" if not code else line, json.loads(out) if not code else None, 1.0))


@dataclass
class Ended:
    outcome: Outcome

    def done(self) -> bool:
        return True

    def result(self) -> Outcome:
        return self.outcome

    def cancel(self) -> None:
        pass


@pytest.fixture
def here(monkeypatch: pytest.MonkeyPatch) -> Here:
    """The one worker that a batch finds in the place of a cluster of this machine."""
    pool = Here()
    monkeypatch.setattr(cluster, "local_workers", lambda *_: contextlib.nullcontext(pool))
    monkeypatch.setattr(command, "check_distributed", lambda: None)
    return pool


def test_every_folder_has_its_run_and_its_row(
    here: Here, captures: list[Path], alone: dict, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    line = (*captures, "--command", "fit", "--out", out, "--json", "--", *OPTIONS)
    code, said, err = call(command.main, *line)
    assert code == 1 and said.count("\n") == 1
    found = json.loads(said)
    assert [run["name"] for run in found["runs"]] == here.ran == ["bar", "bar-2", "empty"]
    assert [run["state"] for run in found["runs"]] == ["done", "done", "failed"]
    assert found["failed"] == ["empty"] and "is not a capture" in found["runs"][2]["line"]
    assert found["runs"][0]["parameters"] == alone["parameters"]
    beliefs = [load_run(run).belief.parameters for run in (out / "bar", out / "bar-2", alone["run"])]
    assert beliefs[0] == beliefs[2] != beliefs[1]
    table = list(csv.DictReader((out / "summary.csv").read_text().splitlines()))
    value = alone["parameters"]["bar.youngs_modulus"]["value"]
    assert float(table[0]["bar.youngs_modulus [Pa]"]) == value
    assert [row["state"] for row in table] == ["done", "done", "failed"]
    assert (out / "summary.html").read_text().startswith("<!doctype html>") and is_marked(out)
    assert "[100 %" in err and "3 of 3 done, 1 failed; empty: " in err
    # again: older results are replaced; what is not a batch's stays
    (out / "mine.txt").write_text("precious")
    code, text, _ = call(command.main, captures[2], "--command", "fit", "--out", out)
    assert code == 1 and "0 of 1 runs done, 1 failed\n  empty: " in text
    assert (out / "mine.txt").read_text() == "precious"


def test_a_batch_that_was_stopped_goes_on(here: Here, captures: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "a batch"
    here.stops = 1
    code, said, err = call(command.main, *captures, "--command", "fit", "--out", out, "--", *OPTIONS)
    assert (code, said) == (130, "")
    last = f"mphygs batch: interrupted; continue with: mphygs batch --out '{out}' --resume"
    assert err.splitlines()[-1] == last
    table = csv.DictReader((out / "summary.csv").read_text().splitlines())
    assert [row["state"] for row in table] == ["done", "waiting", "waiting"]
    here.stops = None
    code, _, err = call(command.main, captures[0], "--command", "fit", "--out", out, "--resume")
    assert code == 2 and "folders: got" in err and "expected the same to resume" in err
    code, said, _ = call(command.main, "--out", out, "--resume")
    assert code == 1 and here.ran == ["bar", "bar-2", "empty"]
    # what failed is tried again, what is done is not
    make_capture(captures[2])
    code, said, _ = call(command.main, "--out", out, "--resume")
    assert code == 0 and here.ran[3:] == ["empty"] and "3 of 3 runs done, 0 failed" in said
    for path in captures[2].iterdir():
        path.unlink()
    code, said, _ = call(command.main, "--out", out, "--resume")
    assert code == 0 and len(here.ran) == 4


def test_a_plugin_is_run_only_where_it_is_named(
    here: Here, captures: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plugin = tmp_path / "effect.py"
    plugin.write_text(EFFECT)
    monkeypatch.setattr(registry, "_USER", {})
    out = tmp_path / "out"
    here.stops = 0
    line = (captures[0], "--command", "fit", "--out", out)
    assert call(command.main, *line, "--plugin", plugin)[0] == 130
    (tmp_path / "ran").unlink()
    code, _, err = call(command.main, "--out", out, "--resume")
    assert code == 2 and "plugin: got none, but the batch began with" in err
    for words in (["--plugin", str(plugin)], [f"--plugin={plugin}"]):
        document = json.loads((out / "batch.json").read_text())
        document["order"] |= {"options": words, "plugin": None}
        (out / "batch.json").write_text(json.dumps(document))
        code, _, err = call(command.main, "--out", out, "--resume")
        assert code == 2 and err.count("\n") == 1 and "after --: got --plugin" in err
    assert not (tmp_path / "ran").exists() and not here.ran


@pytest.mark.parametrize(
    "text",
    [
        "[]", "{}", "\x00", '{"format": "mphygs-batch/1"}',
        '{"format": "mphygs-batch/1", "order": {"command": 3}}',
    ],
)  # fmt: skip
def test_a_batch_that_is_damaged_is_refused(text: str, here: Here, tmp_path: Path) -> None:
    (tmp_path / "batch.json").write_text(text)
    code, out, err = call(command.main, "--out", tmp_path, "--resume")
    assert (code, out, err.count("\n")) == (2, "", 1) and "batch.json" in err


def test_a_folder_of_somebody_else_is_refused(here: Here, captures: list[Path], tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "summary.csv").write_text("precious")
    line = (captures[0], "--command", "fit", "--out")
    for folder in (tmp_path / "mine", captures[0]):
        before = {path: path.read_bytes() for path in folder.iterdir() if path.is_file()}
        code, _, err = call(command.main, *line, folder)
        assert code == 2 and err.count("\n") == 1 and "expected a new folder" in err
        assert {path: path.read_bytes() for path in folder.iterdir() if path.is_file()} == before
    with held():
        hold(tmp_path / "kept")
        (tmp_path / "kept" / "summary.csv").write_text("precious")
    code, _, err = call(command.main, *line, tmp_path / "kept")
    assert code == 2 and "was not made here" in err
    assert not here.ran


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="dask is not installed")
def test_a_run_on_a_worker_is_as_if_it_were_alone(
    captures: list[Path], alone: dict, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    line = [sys.executable, "-m", "mphygs.batch", captures[0], "--command", "fit", "--out", out, "--json"]
    line += ["--workers", "1", "--", *OPTIONS]
    done = subprocess.run(list(map(str, line)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)["runs"]
    assert found["parameters"] == alone["parameters"]
    kept = json.loads((out / "logs" / "bar.json").read_text())["answer"]
    assert kept["sequences"] == alone["sequences"]
    numbers = [load_file(run / "numbers.safetensors") for run in (out / "bar", Path(alone["run"]))]
    assert all((numbers[0][key] == numbers[1][key]).all() for key in numbers[1])
