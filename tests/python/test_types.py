"""The interface in Python is typed, and the types agree."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("basedpyright") is None, reason="basedpyright is not installed")
def test_types_agree() -> None:
    assert (ROOT / "python" / "mphygs" / "py.typed").is_file()
    line = [sys.executable, "-m", "basedpyright", "--pythonpath", sys.executable]
    found = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stdout
    assert found.stdout.startswith("0 errors"), found.stdout
