"""Benchmarks run: they call what the library has now."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

from mphygs.batch import run_on_workers
from mphygs.batch.work import Outcome, Task

SCRIPTS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.mark.slow
def test_the_benchmark_of_hidden_effects_judges_a_null(tmp_path: Path) -> None:
    command = [sys.executable, str(SCRIPTS / "hidden_effects" / "run.py"), "--cases", "null-white"]
    command += ["--seeds", "0", "--workers", "1", "--out", str(tmp_path), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    (case,) = found["cases"]
    assert "error" not in case and (case["verdict"], case["effects"]) == ("adequate", [])
    assert found["summary"]["false_alarms"] == {"of": 1, "count": 0, "rate": 0.0}
    assert (tmp_path / "results" / "null-white-0.json").is_file()


def loaded(name: str, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The script of a benchmark, in this process."""
    monkeypatch.syspath_prepend(str(SCRIPTS / name))
    spec = importlib.util.spec_from_file_location(f"{name}_run", SCRIPTS / name / "run.py")
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, f"{name}_run", module)
    beside = ("flower", "judge", "table", "cases", "make")  # other benchmarks have files of these names
    for other in beside:
        sys.modules.pop(other, None)
    spec.loader.exec_module(module)
    for other in beside:
        sys.modules.pop(other, None)
    return module


def test_the_benchmark_of_baselines_does_nothing_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    results = tmp_path / "results"
    results.mkdir()
    error = {"rms": 4e-4, "max": 1e-3, "rms_over_sigma": 1.2, "count": 9}
    for row, named in (("discover", ["viscosity"]), ("springs", None)):
        spec = {"hidden": ["viscosity:eta=50"], "seed": 7, "row": row, "markers": 40}
        entry = {"case": "viscosity", "seed": 7, "row": row, "spec": spec, "seconds": 3.0, "effects": named}
        entry |= {"processor": 2.0} if named else {}
        entry |= {"errors": dict.fromkeys(("fitted", "frames", "motion"), error)}
        (results / f"viscosity-7-{row}.json").write_text(json.dumps(entry))
    module = loaded("baselines", monkeypatch)
    command = ["run.py", "--cases", "viscosity", "--seeds", "7", "--out", str(tmp_path), "--rows"]
    monkeypatch.setattr(sys, "argv", [*command, "discover,springs"])
    code = module.main()
    said = capsys.readouterr()
    assert (code, said.err) == (0, "")
    head, _, first, second = said.out.strip().splitlines()
    assert head.startswith("| hidden | seed | model |")
    three = "1.20 (0.40 mm) | 1.20 (0.40 mm) | 1.20 (0.40 mm) | 3 |"
    assert first == f"| viscosity | 7 | discover | {three} 2 | viscosity |"
    assert second == f"| viscosity | 7 | springs | {three} - |  |"
    monkeypatch.setattr(sys, "argv", [*command, "magic"])
    assert module.main() == 2 and "'magic': expected some of discover, elastic" in capsys.readouterr().err


class OneByOne:
    """In the place of workers: what comes of every task is told by `of`; asked: the tasks, in their order."""

    def __init__(self, of: Callable[[Task], Outcome]) -> None:
        self.of, self.asked = of, []

    def threads(self) -> dict[str, int]:
        return {"here": 1}

    def wait(self, _seconds: float) -> None:
        pass

    def submit(self, _address: str, task: Task, _threads: int) -> SimpleNamespace:
        self.asked.append(task)
        outcome = self.of(task)
        return SimpleNamespace(done=lambda: True, result=lambda: outcome, cancel=lambda: None)

    @contextlib.contextmanager
    def workers_for(self, count: int, **_: object) -> Iterator[OneByOne | None]:
        yield self if count else None


def test_rows_of_baselines_are_runs_of_a_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module, made = loaded("baselines", monkeypatch), []
    error = {"rms": 4e-4, "max": 1e-3, "rms_over_sigma": 1.2, "count": 9}
    sequences = {"release": {"fit": error, "predict": error}, "shake": {"predict": error}}
    done = {
        "discover": {"steps": [{"sequences": {}}, {"sequences": sequences}], "effects": ["gravity"]},
        "springs": {"sequences": sequences, "seconds": 40.0},
    }

    def outcome(task: Task) -> Outcome:
        row = task.name.rpartition("-")[2]
        assert task.words[0] == ("discover" if row == "discover" else "fit") and task.resumable
        assert ("--baseline" in task.words) is (row not in ("discover", "elastic"))
        return Outcome(0, "", done[row], 3.0, 2.0) if row in done else Outcome(1, "fell over", None, 1.0)

    workers = OneByOne(outcome)
    monkeypatch.setattr(run_on_workers, "workers_for", workers.workers_for)
    monkeypatch.setattr(module, "make_capture", lambda _, folder: made.append(folder.mkdir(parents=True)))
    command = ["run.py", "--cases", "tilt", "--seeds", "7", "--out", str(tmp_path), "--rows"]
    monkeypatch.setattr(sys, "argv", [*command, "discover,elastic,springs"])
    begun = tmp_path / "logs" / "tilt-7-springs.log"
    begun.parent.mkdir()
    begun.touch()
    assert module.main() == 1 and len(made) == 1
    lines = capsys.readouterr().out.strip().splitlines()[2:]
    three = " | ".join(["1.20 (0.40 mm)"] * 3)
    assert lines[0] == f"| tilt | 7 | discover | {three} | 3 | 2 | gravity |"
    assert "fell over" in lines[1] and lines[1].count("|") == lines[0].count("|")
    # what had been begun before does not say what that took
    assert lines[2] == f"| tilt | 7 | springs | {three} | 40 | - |  |"
    # what failed is tried again, what is done is not
    done["elastic"] = done["springs"]
    assert module.main() == 0 and len(made) == 1
    assert [task.name for task in workers.asked[3:]] == ["tilt-7-elastic"]


def test_a_hidden_effect_is_made_found_and_judged_by_runs_of_a_batch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = loaded("hidden_effects", monkeypatch)
    made_of, cases = module.is_made.__globals__["made_of"], {c.name: c for c in module.chosen(())}
    error = {"rms": 4e-4, "max": 1e-3, "rms_over_sigma": 1.2, "count": 9}
    row = {"effect": "viscosity", "predicted_drop": 70.0, "drop": 100.0}
    eta = {"value": 56.0, "std": 4.0, "unit": "Pa s", "determined": True}
    first = {"added": [], "ties": [], "table": [], "parameters": {}, "sequences": {"a": {"fit": error}}}
    last = first | {"added": ["viscosity"], "ties": ["relaxation"], "table": [row, row | {"effect": "wind"}]}
    last |= {"parameters": {"viscosity.eta": eta}, "sequences": {"a": {"fit": error, "predict": error}}}
    told = {"verdict": "missing", "effects": ["viscosity"], "steps": [first, last], "warnings": []}

    def outcome(task: Task) -> Outcome:
        capture = tmp_path / "captures" / task.name.removesuffix("-capture")
        if task.script is not None:
            assert task.script.name == "make.py" and not task.limited and task.words[2] == str(capture)
            capture.mkdir(parents=True)
            answer = {"signal_over_noise": 3.0, "effects": {"viscosity": {"eta": 50.0}}, "faults": {}}
            (capture / "answer.json").write_text(json.dumps(answer))
            (capture / "case.json").write_text(json.dumps(made_of(cases[task.words[0]], int(task.words[1]))))
            return Outcome(0, "", {}, 1.0)
        assert task.words[:4] == ("discover", str(capture), "--out", str(task.run)) and task.resumable
        task.log.parent.mkdir(exist_ok=True)
        task.log.touch()
        if task.name.startswith("null"):
            return Outcome(1, "fell over", None, 1.0)
        task.run.mkdir(parents=True)
        known = {"p_value": 0.0, "confounded_with": []}
        ranking = [known | {"effect": e, "statistic": x} for e, x in (("wind", 80.0), ("viscosity", 70.0))]
        (task.run / "diagnosis.json").write_text(json.dumps({"ranking": ranking}))
        return Outcome(0, "", told, 3.0)

    workers = OneByOne(outcome)
    monkeypatch.setattr(run_on_workers, "workers_for", workers.workers_for)
    line = ["run.py", "--cases", "null-white,viscosity-usual", "--seeds", "7", "--json"]
    line += ["--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", line)
    assert module.main() == 1
    null, found = json.loads(capsys.readouterr().out)["cases"]
    assert null["error"] == "fell over" and found["statistic"] == 70.0 and found["held_out"] == [1.2]
    assert found["errors_in_std"] == {"viscosity.eta": 1.5} and found["predicted_over_actual"] == [0.7]
    assert (found["effects"], found["ties"], found["seconds"]) == (["viscosity"], ["relaxation"], 3.0)
    # what failed goes on, its capture is kept; what is done is not done again unless that is asked for
    assert module.main() == 1 and [task.name for task in workers.asked[4:]] == ["null-white-7"]
    assert workers.asked[-1].log.exists()
    monkeypatch.setattr(sys, "argv", [*line, "--again"])
    assert module.main() == 1
    assert [task.name for task in workers.asked[5:]] == ["null-white-7", "viscosity-usual-7"]


@pytest.mark.parametrize(("name", "command"), [("nulls", "discover"), ("standard_errors", "fit")])
def test_captures_of_one_truth_are_run_once_and_a_failure_ends_no_other(
    name: str, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    module, made = loaded(name, monkeypatch), []

    def make(_: object, folder: Path) -> None:
        made.append(folder)
        folder.mkdir(parents=True)
        (folder / "answer.json").write_text(json.dumps({"parts": {"bar": {"E": 1e5}}}))

    def outcome(task: Task) -> Outcome:
        assert task.words[0] == command and task.words[1] == str(made[len(workers.asked) - 1].absolute())
        if len(workers.asked) == 1:
            return Outcome(1, "fell over", None, 1.0)
        found = {"parameters": {"bar.youngs_modulus": {"value": 1.03e5, "std": 1e3}}}
        known = {"verdict": "adequate", "effects": [], "missing_force": None}
        return Outcome(0, "", known | found | {"steps": [found]}, 3.0)

    workers = OneByOne(outcome)
    monkeypatch.setattr(run_on_workers, "workers_for", workers.workers_for)
    monkeypatch.setattr(module, "make_capture", make)
    choice = "--kinds=white" if name == "nulls" else "--simulators=mls"
    line = ["run.py", choice, "--seeds", "7,8", "--out", str(tmp_path), "--json"]
    monkeypatch.setattr(sys, "argv", line)
    assert module.main() == 0
    said = capsys.readouterr()
    found = json.loads(said.out)
    (entry,) = found["records"] if name == "nulls" else found
    assert entry["seed"] == 8 and "fell over" in said.err and len(made) == len(workers.asked) == 2
    off = entry["z"]["bar"] if name == "nulls" else entry["parts"]["bar"]["value"] / 1e3 - 100.0
    assert off == pytest.approx(3.0)
    # what failed is tried again, what is done is not
    workers.of = lambda _: Outcome(1, "fell over", None, 1.0)
    assert module.main() == 0 and [task.name[-2:] for task in workers.asked[2:]] == ["-7"]


@pytest.fixture
def garden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """The benchmark of flowers, where none is looked at. fails: names of tasks that do; stages: that a flower
    takes; workers; results: what comes of variants with some options."""
    module = loaded("flowers", monkeypatch)
    garden = SimpleNamespace(fails=set(), stages=["segment", "track frog"])
    own = module.Flower.next.__globals__

    def missing(_: object, folder: Path) -> list[SimpleNamespace]:
        every = [
            SimpleNamespace(name=name, command=name.split()[0], arguments=(), file=folder / name)
            for name in garden.stages
        ]
        return [stage for stage in every if not stage.file.exists()]

    def outcome(task: Task) -> Outcome:
        if task.name in garden.fails:
            return Outcome(1, "no", None, 1.0)
        if task.words[0] in ("segment", "track"):
            home = Path(task.words[task.words.index("--out") + 1])
            name = next(n for n in garden.stages if task.name.endswith(n.replace(" ", "-")))
            (home / own["STAGES"]).mkdir(parents=True, exist_ok=True)
            (home / own["STAGES"] / name).touch()
        return Outcome(0, "", {"seconds": 40.0}, 3.0, 2.0, 5)

    garden.workers = OneByOne(outcome)
    monkeypatch.setitem(own, "missing_stages", missing)
    monkeypatch.setitem(own, "load_capture", lambda _: None)
    monkeypatch.setitem(own, "judged", lambda *_: {"psnr": 30.0})
    monkeypatch.setattr(run_on_workers, "workers_for", garden.workers.workers_for)

    def results(*variants: str, species: tuple[str, ...] = ("daisy",), **more: object) -> list[dict]:
        options = module.Options(out=tmp_path, **more)
        flowers = [module.Flower(options, name, variants) for name in species]
        module.grown(flowers, options)
        return [flower.result(variant) for flower in flowers for variant in variants]

    garden.results = results
    return garden


def asked(garden: SimpleNamespace) -> list[str]:
    """Names of what was run since this was asked before."""
    names = [task.name for task in garden.workers.asked]
    garden.workers.asked.clear()
    return names


def test_what_a_flower_takes_is_run_in_its_order_and_once(garden: SimpleNamespace) -> None:
    found = garden.results("laws", "full", species=("daisy", "lily"), size=80)
    assert [(entry["species"], entry["variant"]) for entry in found] == [
        ("daisy", "laws"), ("daisy", "full"), ("lily", "laws"), ("lily", "full"),
    ]  # fmt: skip
    words = {task.name: task.words for task in garden.workers.asked}
    for name in ("daisy", "lily"):
        own = [key.removeprefix(f"{name}-") for key in words if key.startswith(name)]
        assert own == ["synth", "segment", "track-frog", "laws", "full"]
    given = words["daisy-synth"]
    assert given[given.index("--size") + 1] == "80" and given[given.index("--species") + 1] == "daisy"
    assert "--baseline" in words["lily-laws"] and "--baseline" not in words["lily-full"]
    assert found[0]["processor"] == 2.0 and found[0]["memory"] == 5 and found[0]["psnr"] == 30.0
    assert found[0]["stages"]["track frog"] == {"seconds": 3.0, "processor": 2.0, "memory": 5}
    asked(garden)
    assert garden.results("laws", "full", species=("daisy", "lily"), size=80) == found
    assert asked(garden) == []
    # other variants take the stages that are there; another capture is made anew
    garden.results("laws", "neural", size=80)
    assert asked(garden) == ["daisy-neural"]
    garden.results("laws", size=90)
    assert asked(garden) == ["daisy-synth", "daisy-laws"]
    garden.results("laws", size=90, again=True)
    assert asked(garden) == ["daisy-laws"]


def test_what_fails_of_a_flower_ends_no_other_and_is_tried_again(garden: SimpleNamespace) -> None:
    garden.fails = {"daisy-track-frog", "lily-laws"}
    found = garden.results("laws", "full", species=("daisy", "lily"))
    assert [entry.get("error") for entry in found] == ["mphygs track: no"] * 2 + ["no", None]
    asked(garden)
    garden.fails = set()
    found = garden.results("laws", "full", species=("daisy", "lily"))
    assert not any("error" in entry for entry in found)
    assert asked(garden) == ["daisy-track-frog", "lily-laws", "daisy-laws", "daisy-full"]


def test_a_flower_that_was_broken_off_goes_on(garden: SimpleNamespace, tmp_path: Path) -> None:
    usual, run = garden.workers.of, tmp_path / "runs" / "daisy" / "laws"

    def broken(task: Task) -> Outcome:
        if task.name != "daisy-laws":
            return usual(task)
        run.mkdir(parents=True)
        task.log.parent.mkdir()
        task.log.touch()
        raise KeyboardInterrupt

    garden.workers.of = broken
    with pytest.raises(KeyboardInterrupt):
        garden.results("laws")
    garden.workers.of = usual
    # by its log a worker knows that it was begun; what it had spent of the processor it did not tell
    log = tmp_path / "logs" / "daisy-laws.log"
    (found,) = garden.results("laws")
    assert log.exists() and run.exists()
    assert found["seconds"] == 40.0 and "processor" not in found
    # other options begin anew
    (found,) = garden.results("laws", spacing=0.008)
    assert not log.exists() and not run.exists() and found["processor"] == 2.0
