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
