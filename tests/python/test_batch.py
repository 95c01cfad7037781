"""One command on many folders: which runs an order comes to, how workers share them, and the tables."""

import contextlib
import csv
import importlib.util
import io
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from safetensors.numpy import load_file

from command_example import SPACING, answer, call, make_capture
from mphygs import in_use
from mphygs.__main__ import COMMANDS
from mphygs.__main__ import main as mphygs
from mphygs.batch import __main__ as command
from mphygs.batch import cluster, work
from mphygs.batch.dispatch import MOST_LOST, Running, dispatch
from mphygs.batch.order import Order, options_of, tasks_of
from mphygs.batch.page import page
from mphygs.batch.summary import Row, csv_text, row_of
from mphygs.batch.view import View
from mphygs.batch.work import Outcome, Task
from mphygs.console import Console
from mphygs.fit import __main__ as fit
from mphygs.fit.run import load_run
from mphygs.in_use import held, hold
from mphygs.model import registry
from page_driver import opened

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


def task(name: str, folder: Path = Path("/nowhere"), **more: object) -> Task:
    known = {"words": ("fit", "x"), "run": folder / name, "kept": folder / "logs", "place": folder}
    return Task(name, "x", **(known | {"limited": True, "resumable": True} | more))


def order(*folders: str, **more: object) -> Order:
    return Order(**({"command": "fit", "folders": folders} | more))


def runs(asked: Order) -> dict[str, tuple[str, ...]]:
    tasks = tasks_of(asked, options_of(asked.command, COMMANDS), Path("/out"))
    return {t.name: t.words for t in tasks}


# ---- what an order comes to ---------------------------------------------------------------------
def test_folders_of_one_name_get_runs_of_their_own() -> None:
    found = runs(order("a/bar", "b/bar", "bar", "logs", options=("--spacing", "0.01")))
    assert list(found) == ["bar", "bar-2", "bar-3", "logs-2"]
    assert found["bar-2"] == ("fit", "b/bar", "--spacing", "0.01", "--out", "/out/bar-2")


def test_one_run_for_each_effect_and_seed() -> None:
    found = runs(order("bar", command="discover", each_effect=("viscosity", "drag+tether"), seeds=(3, 7)))
    assert list(found) == [
        "bar-viscosity-seed-3", "bar-viscosity-seed-7", "bar-drag+tether-seed-3", "bar-drag+tether-seed-7",
    ]  # fmt: skip
    words = found["bar-drag+tether-seed-7"]
    assert words[:4] == ("discover", "bar", "--effects", "drag,tether")
    assert words[words.index("--seed") + 1] == "7"
    extended = runs(order("bar", command="extend", each_effect=("viscosity", "drag+tether")))
    assert extended["bar-drag+tether"] == ("extend", "bar", "drag", "tether", "--out", "/out/bar-drag+tether")


def test_a_command_that_writes_into_its_run_is_left_to_do_so() -> None:
    assert runs(order("bar", command="diagnose")) == {"bar": ("diagnose", "bar")}
    assert runs(order("bar", command="compare")) == {"bar": ("compare", "bar")}


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
        (["a", "--command", "diagnose", "--each-effect", "b,c"], "writes into the folder"),
        (["a", "--command", "fit", "--threads", "0"], "--threads: got 0"),
        (["a", "--command", "fit", "--workers", "0"], "--workers: got 0"),
        (["a", "--command", "fit", "--scheduler", "here"], "--scheduler: got 'here'"),
        (["a", "--command", "fit", "--scheduler", "here:1", "--workers", "2"], "not with --scheduler"),
        (["a", "--command", "fit", "--", "--bogus", "3"], "after --: Unrecognized options"),
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


# ---- how workers share the runs -----------------------------------------------------------------
@dataclass
class Steady:
    """Workers that take one look at the clock for every run. lost: after so many looks, addresses."""

    workers: dict[str, int]
    lost: dict[int, str] = field(default_factory=dict)
    looks: int = 0
    busy: dict[str, list] = field(default_factory=dict)
    most: dict[str, int] = field(default_factory=dict)
    begun: list[str] = field(default_factory=list)

    def threads(self) -> dict[str, int]:
        self.looks += 1
        self.workers.pop(self.lost.get(self.looks, ""), None)
        return dict(self.workers)

    def submit(self, address: str, one: Task, threads: int) -> "Run":
        run = Run(self, address, one, threads, self.looks + 2)
        self.begun.append(one.name)
        self.busy.setdefault(address, []).append(run)
        used = sum(r.threads for r in self.busy[address])
        self.most[address] = max(self.most.get(address, 0), used)
        return run


@dataclass
class Run:
    pool: Steady
    address: str
    task: Task
    threads: int
    until: int
    cancelled: bool = False

    def done(self) -> bool:
        return self.address in self.pool.workers and self.pool.looks >= self.until

    def result(self) -> Outcome:
        self.pool.busy[self.address].remove(self)
        return Outcome(0, "", {"threads": self.threads}, 1.0)

    def cancel(self) -> None:
        self.cancelled = True


def keeping(found: dict[str, Outcome]) -> Callable[[Task, Outcome], None]:
    def ended(one: Task, outcome: Outcome) -> None:
        assert one.name not in found, "a run that ended twice"
        found[one.name] = outcome

    return ended


def shared(pool: Steady, count: int, threads: int | None = None) -> dict[str, Outcome]:
    found: dict[str, Outcome] = {}
    tasks = [task(f"t{k}") for k in range(count)]
    dispatch(tasks, pool, ended=keeping(found), look=lambda *_: None, threads=threads, tick=0)
    assert sorted(found) == sorted(t.name for t in tasks)
    return found


def test_no_worker_has_more_than_its_threads() -> None:
    pool = Steady({"a": 4, "b": 1})
    found = shared(pool, 10, threads=2)
    assert pool.most == {"a": 4, "b": 1}
    assert {o.answer["threads"] for o in found.values()} == {1, 2}
    pool = Steady({"a": 4, "b": 1})
    assert {o.answer["threads"] for o in shared(pool, 6).values()} == {4, 1}
    assert all(o.done for o in found.values())


def test_what_a_lost_worker_had_goes_to_another_one() -> None:
    pool = Steady({"a": 1, "b": 1}, lost={2: "a"})
    found = shared(pool, 4)
    assert all(o.done for o in found.values())
    assert sorted(pool.begun) == ["t0", "t0", "t1", "t2", "t3"]


def test_a_run_that_ends_its_workers_fails_alone() -> None:
    pool = Steady({str(k): 1 for k in range(MOST_LOST + 1)})
    pool.workers = {"0": 1}

    def threads() -> dict[str, int]:
        pool.looks += 1
        if any(r.task.name == "t0" for r in pool.busy.pop(next(iter(pool.workers)), ())):
            pool.workers = {str(pool.looks): 1}
        return dict(pool.workers)

    pool.threads = threads  # type: ignore[method-assign]
    found: dict[str, Outcome] = {}
    dispatch([task("t0")], pool, ended=keeping(found), look=lambda *_: None, tick=0)
    assert pool.begun == ["t0"] * MOST_LOST
    assert not found["t0"].done and f"{MOST_LOST} workers were lost with it" in found["t0"].line


def test_an_interruption_stops_what_is_under_way() -> None:
    pool, seen = Steady({"a": 1, "b": 1}), []

    def look(running: list, _workers: int) -> None:
        seen[:] = running
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        dispatch([task("t0"), task("t1")], pool, ended=lambda *_: None, look=look, tick=0)
    assert len(seen) == 2 and all(one.handle.cancelled for one in seen)


# ---- one run, in a process of its own -----------------------------------------------------------
PRINTS = """
import os, sys, time
print("said", flush=True, file=sys.stderr)
names = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
open("heard", "a").write(" ".join(sys.argv[1:]) + "\\n")
if "--resume" in sys.argv and os.path.exists("refuse"):
    sys.stderr.write("mphygs fit: nothing to go on with\\n")
    sys.exit(2)
try:
    time.sleep(float(os.environ.get("SLEEP", "0")))
except KeyboardInterrupt:
    sys.stderr.write("mphygs fit: interrupted\\n")
    sys.exit(130)
print('{"threads": "' + " ".join(os.environ[n] for n in names) + '"}')
"""


@pytest.fixture
def scripted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which a script takes the place of the package that a run's process runs."""
    (tmp_path / "mphygs.py").write_text(PRINTS)
    alone = Path(work.__file__).with_name("alone.py").read_text(encoding="utf-8")
    (tmp_path / "alone.py").write_text(alone.replace("GRACE = 10.0", "GRACE = 2.0"))

    def popen(line: list[str], **known: object) -> subprocess.Popen:
        return subprocess.Popen([sys.executable, str(tmp_path / "alone.py"), *line[3:]], **known)

    monkeypatch.setattr(work, "subprocess", SimpleNamespace(Popen=popen, PIPE=subprocess.PIPE))
    return tmp_path


def heard(folder: Path) -> list[str]:
    return (folder / "heard").read_text().splitlines()


def test_a_run_has_the_threads_of_its_worker(scripted: Path) -> None:
    found = work.work(task("a", scripted), 3)
    assert found.done and found.answer == {"threads": "3 3 3"}
    assert heard(scripted) == ["fit x --json --workers 3"]
    assert work.work(task("b", scripted, limited=False, words=("segment",)), 1).answer == {"threads": "1 1 1"}
    assert heard(scripted)[1] == "segment --json"


def test_a_run_that_was_begun_goes_on_or_begins_anew(scripted: Path) -> None:
    for _ in range(2):
        assert work.work(task("a", scripted), 1).done
    assert heard(scripted)[1:] == ["fit x --json --workers 1 --resume"]
    (scripted / "refuse").touch()
    assert work.work(task("a", scripted), 1).done
    assert heard(scripted)[2:] == ["fit x --json --workers 1 --resume", "fit x --json --workers 1"]


def test_a_run_that_nobody_wants_is_interrupted(scripted: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SLEEP", "60")
    begin = time.monotonic()
    log = task("a", scripted).log
    found = work.work(
        task("a", scripted), 1, withdrawn=lambda: log.exists() and "said" in log.read_text()
    )
    assert time.monotonic() - begin < 30.0
    assert (found.code, found.line, found.done) == (130, "interrupted", False)


def test_a_run_ends_with_the_worker_that_began_it(scripted: Path) -> None:
    line = [sys.executable, str(scripted / "alone.py"), "fit"]
    environment = os.environ | {"SLEEP": "60", "PYTHONPATH": str(scripted)}
    worker = f"""
import subprocess, sys, time
child = subprocess.Popen({line!r}, stdin=subprocess.PIPE, start_new_session=True)
print(child.pid, flush=True)
time.sleep(60)
"""
    began = subprocess.Popen(
        [sys.executable, "-c", worker], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        cwd=scripted, env=environment,
    )  # fmt: skip
    child = int(began.stdout.readline())
    until = time.monotonic() + 30.0
    while not (scripted / "heard").exists() and time.monotonic() < until:
        time.sleep(0.05)
    began.kill()
    began.wait()
    began.stdout.close()
    while _runs(child) and time.monotonic() < until:
        time.sleep(0.05)
    assert not _runs(child)


def _runs(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_a_run_that_is_killed_says_so(scripted: Path) -> None:
    (scripted / "mphygs.py").write_text(f"import os; os.kill(os.getpid(), {int(signal.SIGKILL)})")
    found = work.work(task("a", scripted), 1)
    assert found.line == "was ended by SIGKILL" and not found.done


def test_a_folder_that_is_still_written_to_is_waited_for(scripted: Path) -> None:
    with held():
        hold(scripted / "a")
        began = time.monotonic()
        assert work.work(task("a", scripted), 1, patience=1.0).done
        assert time.monotonic() - began > 1.0
    began = time.monotonic()
    assert not in_use.is_held(scripted / "a") and not in_use.is_held(scripted / "none")


# ---- the tables ---------------------------------------------------------------------------------
def error(rms: float, count: int = 10) -> dict[str, float]:
    return {"rms": rms, "max": 2 * rms, "rms_over_sigma": 1e3 * rms, "count": count}


STEPS = {
    "steps": [
        {"sequences": {"a": {"fit": error(1.0)}}, "parameters": {}},
        {
            "sequences": {
                "a": {"fit": error(3e-3, 30), "predict": None},
                "b": {"fit": error(1e-3), "predict": error(2e-3)},
            },
            "parameters": {
                "bar.youngs_modulus": {"value": 2.5e5, "std": 1e3, "unit": "Pa", "determined": True},
                "drag.c": {"value": 0.1, "std": 0.2, "unit": "1/s", "determined": False},
            },
        },
    ],
    "verdict": "missing",
    "effects": ["drag"],
}


def test_the_row_of_a_run_pools_its_sequences() -> None:
    row = row_of(task("a", seed=3), Outcome(0, "", STEPS, 12.0))
    assert (row.state, row.verdict, row.effects, row.seed) == ("done", "missing", ("drag",), 3)
    assert row.errors["fit"]["rms"] == pytest.approx((0.75 * 9e-6 + 0.25 * 1e-6) ** 0.5)
    assert row.errors["fit"]["max"] == 6e-3 and row.errors["predict"]["rms"] == pytest.approx(2e-3)
    assert row.loose == ["drag.c"]


def test_the_row_of_a_diagnosis_and_of_a_comparison() -> None:
    found = {
        "verdict": "missing", "effects": ["drag"], "path": [{"fitted": 3.0, "unseen": None}, {"fitted": 1.0}],
        "table": [
            {"effect": "drag", "estimate": {"c": 0.5}, "std": {"c": 0.1}, "struck": None},
            {"effect": "tether", "estimate": {"k": 2.0}, "std": {"k": 0.1}, "struck": "why"},
        ],
    }  # fmt: skip
    row = row_of(task("a"), Outcome(0, "", found, 1.0))
    assert row.parameters == {"drag.c": {"value": 0.5, "std": 0.1}}
    assert row.errors == {"fit": {"rms": None, "max": None, "rms_over_sigma": 3.0}}
    held_against = {"sequences": {"a": {"fit": error(1e-3), "predict": None, "all": error(1e-3)}}}
    for adequate, verdict in ((True, "adequate"), (False, "more than noise")):
        row = row_of(task("a"), Outcome(0, "", held_against | {"adequate": adequate}, 1.0))
        assert (row.verdict, row.errors["fit"]["rms"]) == (verdict, 1e-3)


def rows() -> list[Row]:
    found = [row_of(task("first", seed=10), Outcome(0, "", STEPS, 12.0))]
    less = json.loads(json.dumps(STEPS)) | {"verdict": "adequate", "effects": []}
    less["steps"][1]["parameters"]["bar.youngs_modulus"]["value"] = 9.0e4
    found.append(row_of(task("second", seed=9), Outcome(0, "", less, 3.0)))
    line = 'x: "<b>" is no, number; expected one'
    return [*found, row_of(task("third", seed=100), Outcome(2, line, None, 1.0)), row_of(task("4"), None)]


def test_the_table_as_csv_has_every_number_to_its_last_digit() -> None:
    first, second, third, last = csv.DictReader(csv_text(rows()).splitlines())
    assert float(first["fit_rms_m"]) == rows()[0].errors["fit"]["rms"]
    assert (first["bar.youngs_modulus [Pa]"], second["bar.youngs_modulus [Pa]"]) == ("250000.0", "90000.0")
    assert first["bar.youngs_modulus std [Pa]"] == "1000.0" and first["not determined"] == "drag.c"
    assert (third["state"], third["line"]) == ("failed", 'x: "<b>" is no, number; expected one')
    assert (last["state"], last["fit_rms_m"]) == ("waiting", "")


def test_the_page_sorts_by_any_column_without_a_network(tmp_path: Path) -> None:
    text = page("two & more", "mphygs batch", rows(), folders=True)
    assert "http" not in text.replace("http-equiv", "") and "<b>&quot;" not in text and "&lt;b&gt;" in text
    (tmp_path / "summary.html").write_text(text, encoding="utf-8")
    with opened((tmp_path / "summary.html").as_uri()) as shown:

        def order_of() -> list[str]:
            return shown.locator("#runs tbody tr td:first-child").all_inner_texts()

        def click(head: str) -> None:
            shown.get_by_role("button", name=head, exact=True).click()

        assert order_of() == ["first", "second", "third", "4"]
        click("seed")
        assert order_of() == ["second", "first", "third", "4"]
        click("seed")
        assert order_of() == ["third", "first", "second", "4"]
        click("bar.youngs_modulus")
        assert order_of() == ["second", "first", "third", "4"]
        click("verdict")
        assert order_of()[:2] == ["second", "first"]
        click("run")
        assert order_of() == ["4", "first", "second", "third"]
        sorts = shown.evaluate("[...document.querySelectorAll('#runs th')].map(h => h.ariaSort)")
        assert sorts.count("ascending") == 1 and sorts.count("none") == len(sorts) - 1
        colour = shown.evaluate("getComputedStyle(document.querySelector('tr.failed td')).color")
        assert colour == "rgb(213, 94, 0)"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("stream", [io.StringIO(), Terminal()])
def test_all_runs_are_shown_in_one_view(
    stream: io.StringIO, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    view = View(Console(stream), before=1, total=4)
    running = []
    for name, said in (("bar", "reading\n[ 12 %, 3 s] coarse\n"), ("longer", "")):
        one = task(name, tmp_path)
        one.log.parent.mkdir(exist_ok=True)
        one.log.write_text(said)
        running.append(Running(one, "a", 1, None))
    view.look([], 0)
    first = stream.getvalue()
    assert first == "1 of 4 done, 0 under way on 0 workers: waiting for one\n"
    view.ended("bar: missing", failed=True)
    view.look(running, 2)
    shown = stream.getvalue()[len(first) :]
    if stream.isatty():
        assert shown.startswith("\x1b[1F\x1b[J[ 33 %, ")
        assert shown.endswith(
            "2 of 4 done, 1 failed, 2 under way on 2 workers\n  bar     [ 12 %, 3 s] coarse\n  longer  \n"
        )
    else:
        assert shown.startswith("[ 33 %, ") and shown.count("\n") == 1
    assert "2 of 4 done, 1 failed; bar: missing\n" in shown


# ---- whole commands -----------------------------------------------------------------------------
@dataclass
class Here:
    """One worker that runs every task in this process. stops: after so many runs, Ctrl-C."""

    stops: int | None = None
    ran: list[str] = field(default_factory=list)

    def threads(self) -> dict[str, int]:
        return {"here": 1}

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
    monkeypatch.setattr(command, "local", lambda *_: contextlib.nullcontext(pool))
    monkeypatch.setattr(command, "needed", lambda: None)
    return pool


def test_every_folder_has_its_run_and_its_row(here: Here, captures: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    line = (*captures, "--command", "fit", "--out", out, "--json", "--", *OPTIONS)
    code, said, err = call(command.main, *line)
    assert code == 1 and said.count("\n") == 1
    found = json.loads(said)
    assert [run["name"] for run in found["runs"]] == here.ran == ["bar", "bar-2", "empty"]
    assert [run["state"] for run in found["runs"]] == ["done", "done", "failed"]
    assert found["failed"] == ["empty"] and "is not a capture" in found["runs"][2]["line"]
    alone = answer(fit.main, captures[0], "--out", tmp_path / "alone", "--workers", 1, *OPTIONS)
    assert found["runs"][0]["parameters"] == alone["parameters"]
    beliefs = [load_run(run).belief.parameters for run in (out / "bar", out / "bar-2", tmp_path / "alone")]
    assert beliefs[0] == beliefs[2] != beliefs[1]
    table = list(csv.DictReader((out / "summary.csv").read_text().splitlines()))
    value = alone["parameters"]["bar.youngs_modulus"]["value"]
    assert float(table[0]["bar.youngs_modulus [Pa]"]) == value
    assert [row["state"] for row in table] == ["done", "done", "failed"]
    assert (out / "summary.html").read_text().startswith("<!doctype html>") and in_use.is_marked(out)
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


def test_a_worker_that_cannot_run_it_fails_that_run_alone() -> None:
    class Broken:
        def result(self) -> None:
            raise ModuleNotFoundError("No module named 'mphygs'")

    found = cluster._Future(Broken()).result()
    assert not found.done and "No module named 'mphygs'" in found.line


def test_the_first_folder_may_be_named_as_an_option_is(tmp_path: Path) -> None:
    asked = order("-odd", place=str(tmp_path))
    assert next(iter(runs(asked).values()))[1] == "./-odd"
    assert runs(replace(asked, folders=("even",)))["even"][1] == "even"


@pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="dask is not installed")
def test_a_run_on_a_worker_is_as_if_it_were_alone(captures: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "out"
    line = [sys.executable, "-m", "mphygs.batch", captures[0], "--command", "fit", "--out", out, "--json"]
    line += ["--workers", "1", "--", *OPTIONS]
    done = subprocess.run(list(map(str, line)), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    alone = answer(fit.main, captures[0], "--out", tmp_path / "alone", *OPTIONS)
    (found,) = json.loads(done.stdout)["runs"]
    assert found["parameters"] == alone["parameters"]
    kept = json.loads((out / "logs" / "bar.json").read_text())["answer"]
    assert kept["sequences"] == alone["sequences"]
    numbers = [load_file(run / "numbers.safetensors") for run in (out / "bar", tmp_path / "alone")]
    assert all((numbers[0][key] == numbers[1][key]).all() for key in numbers[1])
