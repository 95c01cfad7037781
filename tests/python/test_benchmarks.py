"""Benchmarks run: they call what the library has now."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

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


def test_the_benchmark_of_baselines_does_nothing_twice(tmp_path: Path) -> None:
    results = tmp_path / "results"
    results.mkdir()
    error = {"rms": 4e-4, "max": 1e-3, "rms_over_sigma": 1.2, "count": 9}
    for row, named in (("discover", ["viscosity"]), ("springs", None)):
        spec = {"hidden": ["viscosity:eta=50"], "seed": 7, "row": row, "markers": 40}
        entry = {"case": "viscosity", "seed": 7, "row": row, "spec": spec, "seconds": 3.0, "effects": named}
        entry |= {"errors": dict.fromkeys(("fitted", "frames", "motion"), error)}
        (results / f"viscosity-7-{row}.json").write_text(json.dumps(entry))
    command = [sys.executable, str(SCRIPTS / "baselines" / "run.py"), "--cases", "viscosity", "--seeds", "7"]
    command += ["--rows", "discover,springs", "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    head, _, first, second = done.stdout.strip().splitlines()
    assert head.startswith("| hidden | seed | model |")
    three = "1.20 (0.40 mm) | 1.20 (0.40 mm) | 1.20 (0.40 mm) | 3 |"
    assert first == f"| viscosity | 7 | discover | {three} viscosity |"
    assert second == f"| viscosity | 7 | springs | {three}  |"
    wrong = subprocess.run([*command, "--rows", "magic"], capture_output=True, text=True, check=False)
    assert wrong.returncode == 2 and "'magic': expected some of discover, elastic" in wrong.stderr
