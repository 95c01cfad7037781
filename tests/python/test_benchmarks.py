"""Benchmarks run: they call what the library has now."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

SCRIPTS = Path(__file__).resolve().parents[2] / "benchmarks"


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
    beside = ("judge", "table", "cases")  # other benchmarks have files of these names
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
    assert first == f"| viscosity | 7 | discover | {three} viscosity |"
    assert second == f"| viscosity | 7 | springs | {three}  |"
    monkeypatch.setattr(sys, "argv", [*command, "magic"])
    assert module.main() == 2 and "'magic': expected some of discover, elastic" in capsys.readouterr().err


@pytest.fixture
def garden(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The benchmark of flowers."""
    return loaded("flowers", monkeypatch)


def test_a_flower_is_made_once(garden: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[list[str]] = []

    def measured(arguments: list[str], log: Path) -> dict[str, object]:
        asked.append(arguments)
        Path(arguments[arguments.index("--out") + 1]).mkdir(parents=True, exist_ok=True)
        if len(asked) == 1:
            raise KeyboardInterrupt
        return {}

    monkeypatch.setattr(garden, "measured", measured)
    options = garden.Options(out=tmp_path, size=80)
    with pytest.raises(KeyboardInterrupt):
        garden.made(options, "daisy")
    assert garden.made(options, "daisy") == garden.made(options, "daisy") and len(asked) == 2
    garden.made(garden.Options(out=tmp_path, size=90), "daisy")
    garden.made(options, "lily")
    assert len(asked) == 4 and asked[2][asked[2].index("--size") + 1] == "90" and "lily" in asked[3]


@pytest.fixture
def flowers(garden: ModuleType, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The same, where making, staging and judging a flower say nothing."""
    module = garden
    monkeypatch.setattr(module, "made", lambda options, species: options.out / species)
    monkeypatch.setattr(module, "staged", lambda options, *_: (options.out / "stages", {}))
    monkeypatch.setattr(module, "judged", lambda *_: {})
    return module


def test_a_flower_that_was_broken_off_goes_on(
    flowers: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[list[str], bool]] = []
    outcomes = [KeyboardInterrupt(), None, flowers.CommandError("mphygs fit: no"), None]

    def measured(arguments: list[str], log: Path) -> dict[str, object]:
        run = Path(arguments[arguments.index("--out") + 1])
        asked.append((arguments, run.exists()))
        run.mkdir(parents=True, exist_ok=True)
        (run / "run.json").write_text("{}")
        if (outcome := outcomes[len(asked) - 1]) is not None:
            raise outcome
        return {"seconds": 3.0, "processor": 2.0, "memory": 1, "answer": {"seconds": 40.0}}

    def result(**more: object) -> dict[str, object]:
        (entry,) = flowers.records_of(flowers.Options(out=tmp_path, **more), "daisy", ["laws"])
        return entry

    monkeypatch.setattr(flowers, "measured", measured)
    with pytest.raises(KeyboardInterrupt):
        result()
    assert result()["seconds"] == 40.0 and "--resume" in asked[1][0] and asked[1][1]
    assert result()["seconds"] == 40.0 and len(asked) == 2
    assert "processor" not in result()  # what was broken off did not tell
    # other options, and what failed, begin anew
    assert result(spacing=0.008)["error"] == "mphygs fit: no"
    assert result(spacing=0.008)["processor"] == 2.0
    for arguments, there in asked[2:]:
        assert "--resume" not in arguments and "--baseline" in arguments and not there
